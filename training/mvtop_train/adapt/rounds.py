"""From photographs to an adapted bundle: accept, learn, accept again, in a given time."""

import json
import shutil
from dataclasses import dataclass
from pathlib import Path

from ..errors import UserError
from ..evaluation.boxes import Detector
from ..files import write_text
from ..training import runconfig
from ..training.calibrate import TOO_FEW
from ..training.own_parts import END_MINUTES
from ..training.pipeline import LEAST_TRAINING, Stages
from . import exposures, gain, labels, learn, page
from .accept import Judge
from .labels import Labels

LEAST_LABELS = 20  # objects in images, all together
MOST_ROUNDS = 3
BETWEEN = 1.5  # minutes for export and acceptance after an iteration
CALIBRATION = 0.25  # share of the minutes
LEAST_SCENES = 20  # that it is fitted on


@dataclass(frozen=True)
class Options:
    """What a person asks for.

    rig                 None of photographs in BOP's layout
    confidence, views   that a pose needs at least
    only_show           whether to end with the page
    force               whether to replace a bundle that is there
    """

    images: Path
    rig: Path | None
    out: Path
    minutes: float
    confidence: float
    views: int
    only_show: bool = False
    force: bool = False


def run(source: learn.Source, options: Options):
    """Adapts a bundle, and tells what was gained."""
    stages, bundle = Stages(options.minutes), options.out / "bundle"
    if source.bundle.resolve() == bundle.resolve():
        raise UserError(
            f"--out: expected another folder than the bundle's, got {options.out}; fix: a new one, "
            "such as runs/mine-adapted"
        )
    if bundle.exists() and not (options.force or options.only_show):
        raise UserError(
            f"{bundle}: expected no such folder, got one; fix: --force to replace it, or another "
            "--out"
        )
    adaptation = Adaptation(source, options, stages)
    learnt = adaptation.accepted_by(source.bundle)
    stages.done("acceptance")
    refuse_few(learnt, options)
    if options.only_show:
        return
    weights, learnt = adaptation.learn(learnt)
    calibrated = adaptation.finish(weights)
    stages.done("thresholds, export, calibration")
    if not calibrated:
        print(
            f"note: {bundle} is not calibrated, poses have no confidence, and what was gained is "
            f"not measured: {TOO_FEW}; fix: more rendered scenes in --data, or --held-out"
        )
        return
    adaptation.tell_gain(learnt)
    stages.done("gain")


def refuse_few(learnt: Labels, options: Options):
    """UserError where there is too little to learn from."""
    if learnt.count < LEAST_LABELS:
        raise UserError(
            f"{options.images}: expected accepted poses in at least {LEAST_LABELS} images, objects "
            f"counted one by one, got {len(learnt.poses)} poses in {learnt.count}; fix: more "
            "exposures, a better calibrated rig (mvtop-cli rig check), or --min-confidence below "
            f"{options.confidence:g}"
        )


def calibration_scenes(minutes: float, held_out: int) -> int:
    """How many held-out scenes the calibration is fitted on, to end in time."""
    fitting = int(CALIBRATION * minutes / END_MINUTES[1])
    return min(held_out, max(fitting, LEAST_SCENES))


def training_minutes(stages: Stages, scenes: int) -> float:
    """What is left for training, before export, calibration and what was gained.

    - scenes: that the calibration is fitted on
    """
    return stages.left() - END_MINUTES[0] - END_MINUTES[1] * scenes - BETWEEN


class Adaptation:
    """One bundle and the photographs that it is adapted to."""

    def __init__(self, source: learn.Source, options: Options, stages: Stages):
        self.source, self.options, self.stages = source, options, stages
        self.known = source.known()
        self.work = options.out / "work"
        self.photographs = self.work / "photographs"
        found = exposures.read(options.images, options.rig, options.views)
        self.shown, self.held = exposures.split(found, options.views)
        self.scenes = calibration_scenes(options.minutes, source.fields["held_out"])
        self.struck = page.struck(options.out, self.known)

    def judge(self, bundle: Path) -> Judge:
        return Judge(bundle, self.known, self.options.confidence, self.options.views)

    def accepted_by(self, bundle: Path, before: Labels | None = None) -> Labels:
        """What a bundle accepts in the photographs; written as data set, list and page.

        - before: what was accepted before, which is kept
        """
        learnt = labels.of(self.judge(bundle), self.shown, self.struck, before)
        detector = Detector(bundle)
        labels.write(self.photographs, self.shown, learnt, self.source.data, detector)
        page.write(self.options.out, learnt, self.struck, self.photographs)
        told = self.options.out / page.PAGE
        print(f"{len(learnt.poses)} poses accepted in {learnt.count} images: {told}", flush=True)
        return learnt

    def learn(self, learnt: Labels) -> tuple[Path, Labels]:
        """Rounds of training, and of acceptance by what that made; the last one, of what is
        accepted when nothing new is, takes the time that is left. Weights, and what was accepted.
        """
        weights, last = learn.weights_of(self.source, self.work), False
        settings = self.source.settings(weights)
        for number in range(1, MOST_ROUNDS + 1):
            left = training_minutes(self.stages, self.scenes)
            if number == 1 and left <= LEAST_TRAINING * self.options.minutes:
                short = (self.options.minutes - left) / (1 - LEAST_TRAINING)
                raise UserError(
                    f"--minutes: expected more than {short:.1f} (acceptance, calibration, and some "
                    f"training), got {self.options.minutes:g}; fix: more of them"
                )
            if number > 1 and left < BETWEEN:
                break
            last = last or number == MOST_ROUNDS or left < 4 * BETWEEN
            folder = self.work / f"round-{number}"
            shutil.rmtree(folder, ignore_errors=True)
            minutes = left if last else left / 2
            now = {"init": str(weights), "seed": settings.seed + 1, "minutes": minutes}
            settings = settings.model_copy(update=now)
            weights = learn.train(settings, self.photographs, folder)
            self.stages.done(f"round {number}")
            if last:
                break
            learn.interim(self.source, settings, weights, folder / "bundle")
            more = self.accepted_by(folder / "bundle", learnt)
            last = more.count <= learnt.count
            learnt = more
            self.stages.done("acceptance")
        return weights, learnt

    def finish(self, weights: Path) -> bool:
        """The run folder as those of `mvtop_train.run` are, so that it can be adapted again;
        whether its bundle is calibrated."""
        made, bundle = self.work / "bundle", self.options.out / "bundle"
        shutil.rmtree(made, ignore_errors=True)
        settings = self.source.settings(weights)
        calibrated = learn.final(settings, weights, made, self.scenes)
        shutil.copyfile(weights, self.options.out / "weights.pt")
        write_text(self.options.out / "config.toml", runconfig.dump(settings))
        if bundle.exists():
            shutil.rmtree(bundle)
        made.replace(bundle)
        return calibrated

    def tell_gain(self, learnt: Labels):
        """Prints what was gained, and writes it as `gain.json`."""
        if not self.held:
            print("note: what was gained is not measured: of so few photographs none is held out")
            return
        bundles = {"before": self.source.bundle, "after": self.options.out / "bundle"}
        judges = {name: self.judge(bundle) for name, bundle in bundles.items()}
        truth = gain.truth_of(list(judges.values()), self.held, learnt.accepted, self.struck)
        told = {
            name: gain.measured(judges[name], bundle, self.held, truth)
            for name, bundle in bundles.items()
        }
        write_text(self.options.out / "gain.json", json.dumps(told, indent=1) + "\n")
        print(gain.table(told["before"], told["after"]))

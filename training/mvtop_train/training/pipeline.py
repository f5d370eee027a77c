"""From nothing to a trained, exported and evaluated network, in a given time.

Scenes are rendered by all cores while the network already trains on those that are there. A GL
context and PyTorch are for different processes: generating and exporting are commands of their own.
"""

import json
import os
import shutil
import sys
import time
from pathlib import Path

from .. import children
from ..data import bank, batches, bop, search
from ..errors import UserError
from ..files import write_text
from ..network import lite
from . import (
    calibrate,
    checkpoint,
    loop,
    processes,
    runconfig,
    thresholds,
)
from .generator import Generator, test_split
from .validate import pose_views, validate

MOST_VIEWS = 4  # in the report
LEAST_TRAINING = 0.15  # share of all minutes
LEAST_REPORTED = 8  # scenes
RENDERED = 45  # scenes a minute by each core, of four views of a dozen parts


class Stages:
    """Tells how long each stage took."""

    def __init__(self, minutes: float):
        self.minutes, self.begun = minutes, time.monotonic()
        self.mark = self.begun

    def left(self) -> float:
        return self.minutes - (time.monotonic() - self.begun) / 60

    def done(self, name: str):
        now = time.monotonic()
        print(f"{name}: {(now - self.mark) / 60:.1f} min, {self.left():.1f} min left", flush=True)
        self.mark = now


def evaluate(settings: runconfig.RunConfig, folder: Path, model, step: int) -> dict:
    """Errors of the run's average on the test split, with lightly jittered true boxes."""
    known, split = settings.known(), test_split(settings)
    scenes = batches.Scenes(Path(settings.data), known, 0, split).training
    maker = pose_views(settings, model.config, known, False)
    result = {"step": step, "split": split, "things": len(scenes)}
    for views in (1, 2, 3):
        if any(len(scene) >= views for scene in scenes):
            errors = validate(model, scenes, maker, "fp32", views, per_scene=1)
            result[f"views_{views}"] = errors
    (folder / "evaluation.json").write_text(json.dumps(result, indent=1) + "\n")
    return result


def run(settings: runconfig.RunConfig, folder: Path, minutes: float):
    stages = Stages(minutes)
    refuse_early(settings, folder)
    training_minutes(settings, stages, rendering_minutes(settings), LEAST_TRAINING)
    generator = Generator(settings, folder)
    try:
        for split, scenes in first_scenes(settings).items():
            generator.wait_for(split, scenes)
            # Parts and rig are accepted: from here on the run keeps its scenes, whatever ends it.
            runconfig.keep_copy(settings, folder)
        for note in generator.notes():
            print(note)
        stages.done("first scenes")
        left = training_minutes(settings, stages)
        share = 0.0 if settings.pretrained else settings.second.share
        bound = kept_minutes(folder, minutes, left * (1 - share))
        loop.train(settings.model_copy(update={"minutes": bound}), folder)
        generator.check()
    finally:
        generator.stop()
    stages.done("first stage, boxes and features")
    weights = folder / "weights.pt"
    if share:
        weights = second_stage(settings, folder, stages, left * share)
        stages.done("second stage, poses")
    model, _, step = checkpoint.load_weights(weights)
    model.to(processes.join().device)
    found = thresholds_of(settings, model)
    print(found)
    export(settings, weights, folder / "bundle", found)
    stages.done("thresholds, export")
    begun = stages.left()
    scenes = calibrated(settings, folder / "bundle")
    scene_minutes = (begun - stages.left()) / max(scenes, 1)
    stages.done("calibration")
    if settings.generate.mesh or settings.pretrained:
        report(settings, folder, scenes_in_time(stages.left(), scene_minutes))
        stages.done("report")
    else:
        print(json.dumps(evaluate(settings, folder, model, step), indent=1))
        stages.done("evaluation")
    print(f"{folder}: {minutes - stages.left():.1f} minutes of {minutes:g}")


def refuse_early(settings: runconfig.RunConfig, folder: Path):
    """UserError where scenes would be rendered for nothing."""
    if not settings.closeup:
        raise UserError(
            "network.closeup: expected above 0, as bundles have close-ups, got 0; fix: leave it out"
        )
    runconfig.refuse_another(settings, folder)
    loop.composer_of(settings)
    start = Path(settings.init)
    if settings.init and not start.exists() and not (folder / checkpoint.LAST).exists():
        raise UserError(
            f"init: expected a checkpoint or a bundle, got no {start}; fix: another path"
        )
    if settings.pretrained and (not settings.init or start.is_dir()):
        lite.pretrained_file()


def first_scenes(settings: runconfig.RunConfig) -> dict[str, int]:
    """How many of each split there must be before the training begins: all where features are kept
    of them, else so many that those held out stay the same ones."""
    recipe = settings.generate
    start = recipe.scenes if settings.pretrained else max(recipe.start, 2 * settings.held_out + 1)
    return {test_split(settings): recipe.test, "train": min(start, recipe.scenes)}


def rendering_minutes(settings: runconfig.RunConfig) -> float:
    """About how long those of `first_scenes` take that are not there."""
    missing = (
        max(0, scenes - len(bop.whole_scenes(Path(settings.data) / split)))
        for split, scenes in first_scenes(settings).items()
    )
    return sum(missing) / RENDERED / (settings.generate.workers or os.cpu_count() or 1)


def training_minutes(
    settings: runconfig.RunConfig, stages: Stages, rendering=0.0, least=0.0
) -> float:
    """What is left for the training, after that many minutes more of rendering.

    least  share of all minutes
    """
    left = stages.left() - settings.generate.reserve - rendering
    if left <= least * stages.minutes:
        raise UserError(
            f"--minutes: expected more than {(stages.minutes - left) / (1 - least):.1f} (first "
            "scenes, generate.reserve for the end, and some training), got "
            f"{stages.minutes:g}; fix: more of them"
        )
    return left


def kept_of(stage: Path) -> dict:
    """What is kept of when a stage began."""
    path = stage / "stage.json"
    return json.loads(path.read_text()) if path.exists() else {}


def kept_minutes(stage: Path, asked: float, minutes: float, backbone: str = "") -> float:
    """Of a stage's training: those of when it began, unless others are `asked` for now. A run that
    is resumed trains for as long as if it had not been stopped.

    backbone  digest of the weights whose features it learns from
    """
    kept = kept_of(stage)
    if kept.get("asked") != asked:
        kept = {"asked": asked, "training": minutes, "backbone": backbone}
        stage.mkdir(parents=True, exist_ok=True)
        bop.write_json(stage / "stage.json", kept)
    return kept["training"]


def second_stage(
    settings: runconfig.RunConfig, folder: Path, stages: Stages, minutes: float
) -> Path:
    """Poses, on what the first stage has made of the features: where that has trained on since they
    were learnt, they are learnt anew. The weights."""
    weights, poses = folder / "weights.pt", folder / "poses"
    backbone = checkpoint.digest(weights)
    if kept_of(poses).get("backbone", backbone) != backbone:
        shutil.rmtree(poses)
    if not bank.is_of(poses / "features", backbone):
        shutil.rmtree(poses / "features", ignore_errors=True)
    # Validation and features were on no clock; poses are learnt even where these took too long.
    most = max(stages.left() - settings.generate.reserve, minutes / 2)
    changes = settings.second.model_dump(exclude={"share"})
    changes |= {
        "backbone": str(weights), "copies": settings.second.copies or settings.copies,
        "minutes": kept_minutes(poses, stages.minutes, min(minutes, most), backbone),
    }  # fmt: skip
    loop.train(settings.model_copy(update=changes), poses)
    return poses / "weights.pt"


def export(settings: runconfig.RunConfig, weights: Path, bundle: Path, found):
    """The bundle, not calibrated.

    found  the detector's `thresholds.Thresholds`
    """
    children.ended_well(children.python(
        "-m", "mvtop_train.export", "--weights", weights, "--data",
        settings.data, "--out", bundle, "--bits", 8, "--score-threshold", found.score,
        "--agree-threshold", found.agree, "--integers",
        *(["--object", settings.object] if settings.object else []),
    ))  # fmt: skip


def calibrated(settings: runconfig.RunConfig, bundle: Path) -> int:
    """Fits what the bundle stores about its poses, on the held-out scenes of the training split;
    how many these are."""
    scenes = bop.scenes_of(held_images(settings))
    if not calibrate.calibrate(bundle, scenes, settings.known()):
        print(f"note: {bundle} is not calibrated, poses have no confidence: {calibrate.TOO_FEW}")
    return len(scenes)


def scenes_in_time(left: float, scene_minutes: float) -> int:
    """How many scenes the report may have, to be there in time, but `LEAST_REPORTED` at least.

    - left: minutes for the report
    - scene_minutes: what the calibration took for each of its scenes, which is more
    """
    return max(int(left / max(scene_minutes, 1e-6)), LEAST_REPORTED)


def thresholds_of(settings: runconfig.RunConfig, model) -> thresholds.Thresholds:
    """Chosen on the held-out scenes of the training split, so that the test split stays unseen."""
    searches = search.Searches(model.config, settings.known())
    return thresholds.choose(model, held_images(settings), searches)


def held_images(settings: runconfig.RunConfig) -> list[bop.Image]:
    """Of the training split, those that are not trained on."""
    scenes = batches.Scenes(Path(settings.data), settings.known(), settings.held_out)
    return scenes.held_images or scenes.images


def report(settings: runconfig.RunConfig, folder: Path, most: int):
    """What a user would get: images in, poses out, on scenes that were never trained on.

    - most: scenes at most
    """
    scenes = bop.whole_scenes(Path(settings.data) / test_split(settings))
    if len(scenes) > most:
        print(f"note: the report is of {most} of {len(scenes)} scenes, as the time allows")
    shown = [(scene, bop.read_images(scene)) for scene in scenes[:most]]
    # Scenes that not all cameras see are taken with as many as do.
    views = min(MOST_VIEWS, max(len(images) for _, images in shown))
    # As of BOP 2024: which images are evaluated.
    targets = [
        {"scene_id": int(scene.name), "im_id": image.number}
        for scene, images in shown
        for image in images
    ]
    listed = folder / "report-targets.json"
    write_text(listed, json.dumps(targets) + "\n")
    children.ended_well([
        str(Path(sys.executable).with_name("mvtop-cli")), "eval", "bop",
        "--dataset", settings.data, "--split", test_split(settings), "--views", str(views),
        "--targets", str(listed), "--model", str(folder / "bundle"),
        "--report", str(folder / "report"), "--force",
    ])  # fmt: skip
    print(f"what to expect of it: {folder / 'report' / 'report.html'}")

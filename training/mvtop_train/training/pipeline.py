"""From nothing to a trained, exported and evaluated network, in a given time.

Scenes are rendered by all cores while the network already trains on those that are there. A GL
context and PyTorch are for different processes: generating and exporting are commands of their own.
"""

import contextlib
import json
import os
import subprocess
import sys
import time
from pathlib import Path

from tqdm import tqdm

from ..data import bank, batches, bop, search
from ..errors import UserError
from . import (
    checkpoint,
    confidence,
    deviation,
    heldout,
    loop,
    prints,
    processes,
    runconfig,
    support,
    thresholds,
)
from .validate import pose_views, validate

MOST_VIEWS = 4  # in the report


def test_split(settings: runconfig.RunConfig) -> str:
    """What the result is evaluated on."""
    return "test" if settings.generate.mesh else "hard"


class Generator:
    """The generator in processes of its own, behind those that train when cores are short."""

    def __init__(self, settings: runconfig.RunConfig, folder: Path):
        self.data, self.log = Path(settings.data), folder / "generate.log"
        folder.mkdir(parents=True, exist_ok=True)
        recipe = settings.generate
        parts = ((test_split(settings), recipe.test, 2), ("train", recipe.scenes, None))
        commands = [
            [*_command(settings), "--split", split, "--scenes", str(scenes),
             "--views", str(views or recipe.views)]
            for split, scenes, views in parts
        ]  # fmt: skip
        script = "import os, subprocess; os.nice(10)\n"
        script += f"for command in {commands!r}: subprocess.run(command, check=True)"
        with open(self.log, "w") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-c", script], stdout=log, stderr=log, start_new_session=True
            )

    def wait_for(self, split: str, scenes: int):
        """Until the split has `scenes` whole ones; they come in about their order."""
        folder = self.data / split
        with tqdm(total=scenes, unit="scene", desc=f"first of {split}") as bar:
            while bar.n < scenes:
                whole = sum(bop.is_whole(p) for p in folder.iterdir()) if folder.is_dir() else 0
                bar.update(min(whole, scenes) - bar.n)
                if bar.n < scenes:
                    self.check()
                    time.sleep(0.5)

    def check(self):
        if self.process.poll():
            lines = [x for x in self.log.read_text().splitlines() if "error: " in x] or ["?"]
            told = lines[-1].removeprefix("error: ")
            raise UserError(f"generating scenes failed: {told}; see {self.log}")

    def stop(self):
        """End it with all its workers; scenes that are not whole are made anew next time."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, 15)
        self.process.wait()


def _command(settings: runconfig.RunConfig) -> list[str]:
    """Of the generator, without the split and its size."""
    recipe = settings.generate
    command = [
        sys.executable, "-m", "mvtop_train.generate", "--out", settings.data,
        "--workers", str(recipe.workers or os.cpu_count()),
    ]  # fmt: skip
    if not recipe.mesh:
        return command + (["--window", str(recipe.window)] if recipe.window else [])
    for option in ("mesh", "name", "id", "rig"):
        for value in getattr(recipe, option):
            command += [f"--{option}", str(value)]
    for option in ("mesh_unit", "instances", "width"):
        if getattr(recipe, option):
            command += ["--" + option.replace("_", "-"), str(getattr(recipe, option))]
    return command + (["--backgrounds", settings.backgrounds] if settings.backgrounds else [])


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
    # What is pretrained learns to tell a part's places first, and is frozen before poses.
    first = settings.model_copy(update={"poses": settings.poses and not settings.pretrained})
    runconfig.keep_copy(first, folder)
    generator = Generator(settings, folder)
    try:
        recipe = settings.generate
        generator.wait_for(test_split(settings), recipe.test)
        generator.wait_for("train", min(recipe.start, recipe.scenes))
        stages.done("first scenes")
        left = stages.left() - recipe.reserve
        if left <= 0:
            raise UserError(
                f"--minutes: expected more than {minutes - left:.1f} (first scenes, and "
                f"generate.reserve for the end), got {minutes:g}; fix: more of them"
            )
        share = settings.second.share if settings.closeup else 0.0
        loop.train(first.model_copy(update={"minutes": left * (1 - share)}), folder)
        generator.check()
    finally:
        generator.stop()
    stages.done("first stage, boxes and features")
    weights = folder / "weights.pt"
    if share:
        poses = settings.second.model_dump(exclude={"share"})
        poses |= {"backbone": str(weights), "minutes": left * share}
        kept = folder / "features"
        if (kept / "state.json").exists() and not (folder / "poses" / "features").exists():
            model, _, _ = checkpoint.load_weights(weights)
            bank.carry_on(kept, folder / "poses" / "features", model.features)
        loop.train(settings.model_copy(update=poses), folder / "poses")
        weights = folder / "poses" / "weights.pt"
        stages.done("second stage, poses")
    model, _, step = checkpoint.load_weights(weights)
    model.to(processes.join().device)
    found = thresholds_of(settings, model)
    export(settings, weights, folder / "bundle", found)
    print(found)
    print(json.dumps(evaluate(settings, folder, model, step), indent=1))
    stages.done("thresholds, export, evaluation")
    if settings.generate.mesh:
        report(settings, folder)
        stages.done("report")
    print(f"{folder}: {minutes - stages.left():.1f} minutes of {minutes:g}")


def export(settings: runconfig.RunConfig, weights: Path, bundle: Path, found):
    """The bundle; where it gives object coordinates, with the least support that is believed; with
    what true calibrations leave of views that disagree; of printed parts, with how far images must
    look like them; and how probable it is that its poses are right."""
    command = [
        sys.executable, "-m", "mvtop_train.export", "--weights", str(weights), "--data",
        settings.data, "--out", str(bundle), "--bits", "8", "--score-threshold", str(found.score),
        "--agree-threshold", str(found.agree), *(["--integers"] if settings.closeup else []),
    ]  # fmt: skip
    subprocess.run(command, check=True)
    scenes, known = support.scenes_of(held_images(settings)), settings.known()
    if settings.pretrained:
        least = support.choose(*support.found_in(bundle, scenes, known))
        print(f"least support: {least:g}")
        heldout.put(bundle, "support_threshold", least)
    most = deviation.choose(deviation.found_in(bundle, scenes))
    if most is not None:
        print(f"most deviation: {most:g}")
        heldout.put(bundle, "most_deviation", most)
    judged = confidence.judged(bundle, scenes, known, confidence.DISTURBED)
    least = prints.choose([one for one in judged if not one.disturbed])
    if least is not None:
        print(f"least likeness to the print: {least:g}")
        prints.add(bundle, least)
    fitted = confidence.fit(prints.kept(judged, least))
    if fitted is not None:
        confidence.add(bundle, fitted)


def thresholds_of(settings: runconfig.RunConfig, model) -> thresholds.Thresholds:
    """Chosen on the held-out scenes of the training split, so that the test split stays unseen."""
    searches = search.Searches(model.config, settings.known())
    return thresholds.choose(model, held_images(settings), searches)


def held_images(settings: runconfig.RunConfig) -> list[bop.Image]:
    """Of the training split, those that are not trained on."""
    scenes = batches.Scenes(Path(settings.data), settings.known(), settings.held_out)
    return scenes.held_images or scenes.images


def report(settings: runconfig.RunConfig, folder: Path):
    """What a user would get: images in, poses out, on scenes that were never trained on."""
    scenes = bop.whole_scenes(Path(settings.data) / test_split(settings))
    # Scenes that not all cameras see are taken with as many as do.
    views = min(MOST_VIEWS, max(len(bop.read_images(scene)) for scene in scenes))
    subprocess.run(
        [str(Path(sys.executable).with_name("mvtop-cli")), "eval", "bop",
         "--dataset", settings.data, "--split", test_split(settings), "--views", str(views),
         "--model", str(folder / "bundle"), "--report", str(folder / "report"), "--force"],
        check=True,
    )  # fmt: skip
    print(f"what to expect of it: {folder / 'report' / 'report.html'}")

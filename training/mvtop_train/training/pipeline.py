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

from ..data import bop, objects
from ..errors import UserError
from . import checkpoint, loop, processes, runconfig
from .validate import pose_views, validate

TEST_SPLIT = "hard"


class Generator:
    """The generator in processes of its own, behind those that train when cores are short."""

    def __init__(self, settings: runconfig.RunConfig, folder: Path):
        self.data, self.log = Path(settings.data), folder / "generate.log"
        folder.mkdir(parents=True, exist_ok=True)
        recipe = settings.generate
        workers = recipe.workers or os.cpu_count()
        common = [
            sys.executable, "-m", "mvtop_train.generate", "--out", settings.data,
            "--workers", str(workers),
        ]  # fmt: skip
        if recipe.window:
            common += ["--window", str(recipe.window)]
        parts = ((TEST_SPLIT, recipe.test, 2), ("train", recipe.scenes, None))
        commands = [
            [*common, "--split", split, "--scenes", str(scenes), "--views",
             str(views or recipe.views)]
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


def evaluate(settings: runconfig.RunConfig, folder: Path, weights: Path) -> dict:
    """Errors of the run's average on the test split, with lightly jittered true boxes."""
    model, _, step = checkpoint.load_weights(weights)
    model.to(processes.join().device)
    obj = objects.read(Path(settings.data), settings.object or None)
    scenes = bop.load_index(Path(settings.data), TEST_SPLIT, obj)
    result = {"step": step, "split": TEST_SPLIT, "scenes": len(scenes)}
    maker = pose_views(settings, model.config, obj.bounds, False)
    for views in (1, 2):
        result[f"views_{views}"] = validate(model, scenes, maker, "fp32", views, per_scene=1)
    (folder / "evaluation.json").write_text(json.dumps(result, indent=1) + "\n")
    return result


def run(settings: runconfig.RunConfig, folder: Path, minutes: float):
    begun = time.monotonic()
    runconfig.keep_copy(settings, folder)
    generator = Generator(settings, folder)
    try:
        recipe = settings.generate
        generator.wait_for(TEST_SPLIT, recipe.test)
        generator.wait_for("train", min(recipe.start, recipe.scenes))
        passed = (time.monotonic() - begun) / 60
        left = minutes - passed - recipe.reserve
        if left <= 0:
            raise UserError(
                f"--minutes: expected more than {minutes - left:.1f} (first scenes, and "
                f"generate.reserve for the end), got {minutes:g}; fix: more of them"
            )
        share = settings.second.share if settings.closeup else 0.0
        loop.train(settings.model_copy(update={"minutes": left * (1 - share)}), folder)
        generator.check()
    finally:
        generator.stop()
    bundle, weights = folder / "bundle", folder / "weights.pt"
    if share:
        poses = settings.second.model_dump(exclude={"share"})
        poses |= {"backbone": str(weights), "init": "", "minutes": left * share}
        loop.train(settings.model_copy(update=poses), folder / "poses")
        weights = folder / "poses" / "weights.pt"
    subprocess.run(
        [sys.executable, "-m", "mvtop_train.export", "--weights", str(weights),
         "--data", settings.data, "--out", str(bundle)],
        check=True,
    )  # fmt: skip
    print(json.dumps(evaluate(settings, folder, weights), indent=1))
    print(f"{folder}: {(time.monotonic() - begun) / 60:.1f} minutes of {minutes:g}")

"""The generator of scenes, beside what trains on them."""

import contextlib
import json
import os
import subprocess
import time
from pathlib import Path

from tqdm import tqdm

from .. import children
from ..data import bop
from ..errors import UserError
from .runconfig import RunConfig

# One command after the other, behind those that train when cores are short. They are a group of
# their own, which nothing would end with a run that is killed.
SCRIPT = """
import json, os, signal, subprocess, sys, time
os.nice(10)
run, commands = int(sys.argv[1]), json.loads(sys.argv[2])
for command in commands:
    process = subprocess.Popen(command)
    while process.poll() is None:
        if os.getppid() != run:
            os.killpg(0, signal.SIGTERM)
        time.sleep(0.5)
    if process.returncode:
        sys.exit(1)
"""


def test_split(settings: RunConfig) -> str:
    """What the result is evaluated on."""
    return "test" if settings.generate.mesh else "hard"


class Generator:
    """Processes that render the scenes of a run."""

    def __init__(self, settings: RunConfig, folder: Path):
        self.data, self.log = Path(settings.data), folder / "generate.log"
        folder.mkdir(parents=True, exist_ok=True)
        recipe = settings.generate
        parts = ((test_split(settings), recipe.test, 2), ("train", recipe.scenes, None))
        commands = [
            [*_command(settings), "--split", split, "--scenes", str(scenes),
             "--views", str(views or recipe.views)]
            for split, scenes, views in parts
        ]  # fmt: skip
        self.before = {split: self._taken_up(split) for split, _, _ in parts}
        script = children.python("-c", SCRIPT, os.getpid(), json.dumps(commands))
        with open(self.log, "w") as log:
            self.process = subprocess.Popen(script, stdout=log, stderr=log, start_new_session=True)

    def _taken_up(self, split: str) -> int:
        """When a generator last found that the scenes of a split are of its recipe."""
        path = self.data / split / "recipe.json"
        return path.stat().st_mtime_ns if path.exists() else 0

    def wait_for(self, split: str, scenes: int):
        """Until the split has `scenes` whole ones, of this recipe; they come in about their
        order."""
        with tqdm(total=scenes, unit="scene", desc=f"first of {split}") as bar:
            while True:
                ended = self.check()
                whole = len(bop.whole_scenes(self.data / split))
                bar.update(min(whole, scenes) - bar.n)
                if ended or (bar.n == scenes and self._taken_up(split) != self.before[split]):
                    return
                time.sleep(0.5)

    def check(self) -> bool:
        """Whether it has ended; UserError where that was too early."""
        code = self.process.poll()
        if code:
            lines = self._lines()
            told = [line for line in lines if "error: " in line] or lines or ["no reason given"]
            raise UserError(
                f"generating scenes failed: {told[-1].removeprefix('error: ')}; see {self.log}"
            )
        return code == 0

    def notes(self) -> list[str]:
        """What it has told of the parts and the rig."""
        return list(dict.fromkeys(x for x in self._lines() if x.startswith("note: ")))

    def _lines(self) -> list[str]:
        text = self.log.read_text(errors="replace")
        return [line for line in text.splitlines() if line.strip()]

    def stop(self):
        """End it with all its workers; scenes that are not whole are made anew next time."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, 15)
        self.process.wait()


def _command(settings: RunConfig) -> list[str]:
    """Of the generator, without the split and its size."""
    recipe = settings.generate
    command = children.python(
        "-m", "mvtop_train.generate", "--out", settings.data,
        "--workers", recipe.workers or os.cpu_count(),
    )  # fmt: skip
    if not recipe.mesh:
        return command + (["--window", str(recipe.window)] if recipe.window else [])
    for option in ("mesh", "name", "id", "rig"):
        for value in getattr(recipe, option):
            command += [f"--{option}", str(value)]
    for option in ("mesh_unit", "instances", "width"):
        if getattr(recipe, option):
            command += ["--" + option.replace("_", "-"), str(getattr(recipe, option))]
    return command + (["--backgrounds", settings.backgrounds] if settings.backgrounds else [])

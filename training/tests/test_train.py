"""Training resumes where it was killed, and learns."""

import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import onnx
import pytest
import torch
from conftest import MVBALL, random_views

from mvtop_train import shipped
from mvtop_train.data import bank, batches, bop, crops, objects
from mvtop_train.data.closeup import CloseUps
from mvtop_train.data.inputs import to_views
from mvtop_train.data.views import ViewMaker, collate
from mvtop_train.errors import UserError
from mvtop_train.export import restore
from mvtop_train.network import config as configs
from mvtop_train.network import losses, symmetry
from mvtop_train.network.model import Mvtop
from mvtop_train.synthesis.generate import scene_views
from mvtop_train.synthesis.gl import open_gl
from mvtop_train.training import loop, pipeline, runconfig
from mvtop_train.training.checkpoint import load_weights


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    root = tmp_path_factory.mktemp("mvball")
    objects.write(root, [(objects.ball(), objects.ball_mesh())])
    gl = open_gl()
    for index in range(6):
        order = ["green", "red"] * 2
        views = scene_views(gl, 5, "train", index, order, (320, 320))
        bop.write_scene(root / "train" / f"{index:06d}", views)
    return root


CONFIG = """
preset = "tiny"
steps = 5
images = 16
crop = 64
workers = 0
log_steps = 5
network = {closeup = 0, closeup_strides = []}
"""


CLOSEUPS = ("network.closeup=64", "network.closeup_strides=[16, 32]")


def config_of(dataset, folder):
    path = folder / "tiny.toml"
    path.write_text(f"data = {json.dumps(str(dataset))}\n{CONFIG}")
    return path


def run_of(dataset, folder, *changes):
    """Train; the records of `log.jsonl` with a loss."""
    loop.train(runconfig.load(config_of(dataset, folder.parent), changes), folder)
    records = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    return [r for r in records if "loss" in r]


def test_a_resumed_run_is_the_run_that_was_not_stopped(dataset, tmp_path):
    constant = ("lr=1e-9", "precision=fp32")  # the schedule depends on `steps`
    run_of(dataset, tmp_path / "run", "steps=5", *constant)
    (tmp_path / "run" / "last.part").write_bytes(b"of a kill while saving")
    resumed = run_of(dataset, tmp_path / "run", "steps=10", "workers=1", *constant)
    through = run_of(dataset, tmp_path / "through", "steps=10", *constant)
    assert [r["step"] for r in resumed] == [r["step"] for r in through] == [5, 10]
    for name in ("loss", "rotation_deg", "detection"):
        assert resumed[1][name] == pytest.approx(through[1][name], rel=1e-4)
    assert resumed[1]["loss"] != pytest.approx(resumed[0]["loss"], rel=1e-4)
    for file in ("last.pt", "weights.pt"):
        _, config, step = load_weights(tmp_path / "run" / file)
        assert step == 10 and config.preset == "tiny"
    assert list((tmp_path / "run").glob("events.out.tfevents.*"))


def test_a_run_starts_from_a_bundle_of_other_objects(dataset, tmp_path):
    """What belongs to none of its objects is taken over, but nothing of a start that a run which
    was stopped early has left; a second call goes on from the run's own weights."""
    changes = (
        "preset=lite", "network={width = 128, height = 96, closeup = 64}", "backbone=pretrained",
        f"init={shipped.START}", "copies=1", "images=4", "searched=1", "search_every=2", "lr=1e-9",
        "precision=fp32",
    )  # fmt: skip
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "start.pt").write_bytes(b"of another bundle")
    run_of(dataset, tmp_path / "run", "steps=1", *changes)
    written = (tmp_path / "run" / "start.pt").stat().st_mtime_ns
    run_of(dataset, tmp_path / "run", "steps=2", *changes)
    assert (tmp_path / "run" / "start.pt").stat().st_mtime_ns == written
    start, given, _ = load_weights(tmp_path / "run" / "start.pt")
    model, config, _ = load_weights(tmp_path / "run" / "weights.pt")
    assert len(given.classes) == 4 and [c.name for c in config.classes] == [objects.ball().name]
    before, after = start.state_dict(), model.state_dict()
    for name in ("look.lateral16.weight", "search.smooth8.0.weight", "coordinates.weight"):
        one = before[f"features.{name}"]
        torch.testing.assert_close(after[f"features.{name}"], one, rtol=1e-2, atol=1e-4)
        assert one.std() > 1e-3
    stored = restore.weights_of(onnx.load(shipped.START / "closeup.onnx"))
    torch.testing.assert_close(
        before["features.coordinates.weight"], stored["features.coordinates.weight"],
        rtol=1e-2, atol=1e-4,
    )  # fmt: skip


def test_the_loss_falls(dataset, tmp_path):
    records = run_of(dataset, tmp_path / "run", "steps=40", "lr=5e-3", "warmup=20")
    assert records[-1]["loss"] < 0.8 * records[0]["loss"]


def test_a_run_of_minutes_ends_with_an_annealed_learning_rate(dataset, tmp_path):
    records = run_of(dataset, tmp_path / "run", "steps=0", "minutes=0.1", "warmup=1", "log_steps=1")
    rates = [r["lr"] for r in records]
    assert rates == sorted(rates, reverse=True)
    assert rates[0] > 0.9e-3 and rates[-1] < 0.5e-3


def gradient(path):
    """The only gradient of a run of one step, which Adam keeps as `exp_avg`."""
    state = torch.load(path / "last.pt", weights_only=True)
    moments = [x["exp_avg"].flatten() for x in state["optimizer"]["adamw"]["state"].values()]
    return torch.cat(moments), state["model"]


def test_two_processes_have_the_gradients_of_one(dataset, tmp_path):
    """Batch normalisation in training mode included."""
    # 8 scenes: 4 for each of two. With seed 1 one of the untrained poses is 179.0 degrees off,
    # where the angle's derivative multiplies rounding by sixty; with seed 3 none is over 171.
    changes = ("steps=1", "precision=fp32", "views=[0, 1]", "seed=3")
    for count in ("1", "2"):
        arguments = [
            sys.executable, "-m", "torch.distributed.run", "--standalone",
            "--nproc_per_node", count, "-m", "mvtop_train.train",
            "--config", config_of(dataset, tmp_path), "--out", tmp_path / count,
            *(x for change in changes for x in ("--set", change)),
        ]  # fmt: skip
        result = subprocess.run(arguments, capture_output=True, text=True)
        assert result.returncode == 0, result.stderr
    one, two = (gradient(tmp_path / name) for name in ("1", "2"))
    norm = one[0].norm()
    assert len(one[0]) > 50_000 and norm > 0
    assert (one[0] - two[0]).norm() < 5e-5 * norm  # rounding
    for name, value in one[1].items():
        if "running" in name:
            torch.testing.assert_close(value, two[1][name], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        (["lerning_rate=1"], "unknown key 'lerning_rate'"),
        (["augmentation.zom=[1, 2]"], "did you mean 'zoom'"),
        (["images=many"], "key 'images': expected a whole number, got 'many'"),
        (["steps=0"], "expected a bound: steps or minutes over 0"),
        (["data=/nowhere"], "expected a data set in BOP layout"),
        (["init=/nowhere"], "/nowhere: no such file"),
    ],
)
def test_a_wrong_config_is_one_clear_sentence(dataset, tmp_path, changes, error):
    with pytest.raises(UserError) as refused:
        run_of(dataset, tmp_path / "run", *changes)
    message = str(refused.value)
    assert error in message and "; fix: " in message
    assert "\n" not in message


def test_a_run_is_not_resumed_with_another_config(dataset, tmp_path):
    run_of(dataset, tmp_path / "run", "steps=1")
    with pytest.raises(UserError, match="started with lr = 0.001, got 0.002"):
        run_of(dataset, tmp_path / "run", "steps=1", "lr=2e-3")
    kept = runconfig.load(tmp_path / "run" / "config.toml")
    assert kept == runconfig.load(config_of(dataset, tmp_path), ["steps=1"])


def test_a_folder_without_pictures_is_no_config_to_keep(dataset, tmp_path):
    with pytest.raises(UserError, match="backgrounds .*: expected a folder of pictures"):
        run_of(dataset, tmp_path / "run", f"backgrounds={tmp_path}/none")
    assert not (tmp_path / "run" / "config.toml").exists()


def test_from_nothing_to_a_bundle(dataset, tmp_path):
    """The scenes of the data set are whole, so that the generator adds those of the test split."""
    changes = ["steps=3", "second.copies=1", *CLOSEUPS]
    changes += [f"generate.{x}" for x in ("scenes=6", "start=6", "test=1", "workers=1")]
    settings = runconfig.load(config_of(dataset, tmp_path), changes)
    pipeline.run(settings, tmp_path / "run", minutes=30)
    result = json.loads((tmp_path / "run" / "evaluation.json").read_text())
    assert result["step"] == 3 and result["things"] == 1
    assert 0 < result["views_2"]["rot_mean_deg"] <= 180
    manifest = json.loads((tmp_path / "run" / "bundle" / "model.json").read_text())
    assert manifest["preset"] == "tiny" and "closeup" in manifest
    assert (tmp_path / "run" / "poses" / "weights.pt").exists()


def test_a_run_to_a_bundle_needs_closeups(dataset, tmp_path):
    settings = runconfig.load(config_of(dataset, tmp_path), ["network.closeup=0"])
    with pytest.raises(UserError, match="closeup: expected above 0, as bundles have close-ups"):
        pipeline.run(settings, tmp_path / "run", minutes=30)
    assert not (tmp_path / "run").exists()


def test_a_report_has_as_many_scenes_as_the_time_allows(dataset, tmp_path, monkeypatch, capsys):
    assert pipeline.scenes_in_time(10.0, 0.5) == 20
    assert pipeline.scenes_in_time(-3.0, 0.5) == pipeline.LEAST_REPORTED
    calls = []
    monkeypatch.setattr(pipeline.children, "ended_well", calls.append)
    settings = runconfig.load(config_of(dataset, tmp_path), ["generate.scenes=2"])
    monkeypatch.setattr(pipeline, "test_split", lambda _: "train")
    scenes = bop.whole_scenes(Path(dataset) / "train")
    for most, noted in ((1, True), (len(scenes), False)):
        pipeline.report(settings, tmp_path, most)
        command = calls.pop()
        listed = json.loads(Path(command[command.index("--targets") + 1]).read_text())
        assert sorted({one["scene_id"] for one in listed}) == [int(x.name) for x in scenes[:most]]
        assert len(listed) == sum(len(bop.read_images(scene)) for scene in scenes[:most])
        assert (f"{most} of {len(scenes)} scenes" in capsys.readouterr().out) == noted


def test_crops_without_the_object_show_nothing_of_it(dataset):
    rng = np.random.default_rng(0)
    aug = crops.Augmentation(scale=0.8)
    for scene in bop.load_index(dataset):
        for image in scene:
            a = crops.negative_camera(image, (320, 320), 160, rng, aug)
            if a is None:
                continue
            code, _ = bop.read_coords(image, (320, 320))
            assert code.any() and not cv2.warpAffine(code, a, (160, 160)).any()
    filling = dataclasses.replace(image.only, box=np.array([5, 5, 315, 315]))
    boxed_in = dataclasses.replace(image, instances=[filling])
    assert crops.negative_camera(boxed_in, (320, 320), 160, rng, aug) is None


BALL = symmetry.of(MVBALL)


def about(views) -> dict:
    """What a batch says of views of one ball."""
    return {
        "true_box": views.boxes[:, :, 0],
        "class_index": torch.zeros(1, 1, dtype=torch.long),
        "extent": torch.full(views.boxes.shape[:2], 0.07),
    }


def test_crops_without_the_object_teach_the_detector_and_nothing_else(tiny):
    views = random_views(tiny.config, 2)
    with torch.no_grad():
        alone = tiny(views)
        views.shown.searched = views.shown.images[0, :1].flip(-1)
        both = tiny(views)
    for a, b in zip(alone.poses[-1], both.poses[-1], strict=True):
        torch.testing.assert_close(a, b)
    assert len(both.found.scores) == 3
    pose = torch.eye(4).expand(1, 2, 4, 4)
    batch = {"cam_from_obj": pose, **about(views)}
    batch["coords"] = torch.zeros(1, 2, *both.found.coordinates.shape[-2:], 3)
    quiet = losses.total(both, batch, 8, BALL)[1]
    both.found.scores[2] += 5
    loud = losses.total(both, batch, 8, BALL)[1]
    assert loud["detection"] > quiet["detection"] + 0.1
    assert loud["coordinates"] == quiet["coordinates"]


def test_a_network_with_coarser_cells_learns_the_same_coordinates(tiny):
    views = random_views(tiny.config, 2)
    with torch.no_grad():
        prediction = tiny(views)
    shape = prediction.found.coordinates.shape[-2:]
    batch = {"cam_from_obj": torch.eye(4).expand(1, 2, 4, 4), **about(views)}
    batch["coords"] = torch.randint(1, 256, (1, 2, *shape, 3), dtype=torch.uint8)
    fine = {**batch, "coords": batch["coords"].repeat_interleave(2, 2).repeat_interleave(2, 3)}
    expected = losses.total(prediction, batch, 8, BALL)[1]["coordinates"]
    assert expected > 0
    torch.testing.assert_close(losses.total(prediction, fine, 8, BALL)[1]["coordinates"], expected)


def test_poses_are_learnt_from_closeups_on_a_frozen_backbone(dataset, tmp_path):
    run_of(dataset, tmp_path / "first", "steps=5", *CLOSEUPS)
    first, _, _ = load_weights(tmp_path / "first" / "last.pt")
    second = ("steps=30", "lr=5e-3", "warmup=10", "copies=2", *CLOSEUPS)
    second += (f"backbone={tmp_path / 'first' / 'last.pt'}",)
    records = run_of(dataset, tmp_path / "second", *second)
    assert records[-1]["loss"] < 0.9 * records[0]["loss"]
    assert "detection" not in records[0]
    model, config, step = load_weights(tmp_path / "second" / "last.pt")
    assert (step, config.closeup) == (30, 64)
    for name, weight in model.state_dict().items():
        frozen = name.startswith(("features.backbone", "features.detector", "features.coord"))
        if frozen:
            assert torch.equal(weight, first.state_dict()[name]), name
    moved = "decoder.query.0.weight"
    assert not torch.equal(model.state_dict()[moved], first.state_dict()[moved])
    # Its features are kept: the run goes on without them being computed again.
    written = (tmp_path / "second" / "features" / "features_0.npy").stat().st_mtime_ns
    assert run_of(dataset, tmp_path / "second", *second, "steps=35")[-1]["step"] == 35
    assert (tmp_path / "second" / "features" / "features_0.npy").stat().st_mtime_ns == written


def test_features_of_closeups_are_completed_after_a_kill(dataset, tmp_path, monkeypatch):
    obj = objects.ball()
    config = configs.preset("tiny", MVBALL)
    torch.manual_seed(0)
    model = Mvtop(config).eval()
    scenes = bop.load_index(dataset, "train", obj)
    monkeypatch.setattr(bank, "BATCH", 10)

    maker = ViewMaker(CloseUps(64), config, (obj,))

    def make(folder, copies=2, backbone=""):
        return bank.Bank(folder, scenes, maker, model.features, copies, 4, 0, backbone)

    whole = make(tmp_path / "whole")
    fill = bank.Bank._fill

    def killed(self, *args):
        for n, done in enumerate(fill(self, *args)):
            yield done
            if n == 1:
                raise KeyboardInterrupt

    monkeypatch.setattr(bank.Bank, "_fill", killed)
    with pytest.raises(KeyboardInterrupt):
        make(tmp_path / "cut")
    monkeypatch.setattr(bank.Bank, "_fill", fill)
    resumed = make(tmp_path / "cut")
    for name, array in whole.arrays.items():
        np.testing.assert_array_equal(resumed.arrays[name], array)
    assert np.abs(whole.arrays["features_0"]).max(1).min() > 0, "every cell is there"
    with pytest.raises(UserError, match="expected features of"):
        make(tmp_path / "cut", copies=1)
    with pytest.raises(UserError, match="expected features of .*'backbone': 'another'"):
        make(tmp_path / "cut", backbone="another")
    batch = batches.Batches(whole, 6, (0, 1.0), 0, 0, 1)[0]
    # What the network says of cached features is what it says of the pictures.
    pictures = bank.Copies([image for s in scenes for image in s] * 2, maker, 4)
    rows = [int(np.abs(whole.arrays["k"] - k).sum((1, 2)).argmin()) for k in _flat(batch["k"])]
    views = [pictures[row] for row in rows]
    shown = collate([views[i : i + 2] for i in range(0, 6, 2)])
    with torch.no_grad():
        cached = model(to_views(batch, config)).poses[-1]
        direct = model(to_views(shown, config)).poses[-1]
    for a, b in zip(cached, direct, strict=True):
        torch.testing.assert_close(a, b, rtol=0.05, atol=0.05)  # bf16 and half in between


def _flat(k):
    return k.flatten(0, 1).double().numpy()


@pytest.mark.parametrize(
    "changes, error",
    [
        (("backbone=x.pt",), "without close-ups"),
        (("backbone=pretrained", *CLOSEUPS), "'backbone': expected a checkpoint"),
        (("backbone=none.pt", *CLOSEUPS), "no such file"),
        (("copies=0",), "at least 1"),
    ],
)
def test_a_second_stage_that_cannot_be_is_one_clear_sentence(dataset, tmp_path, changes, error):
    with pytest.raises(UserError, match=error):
        run_of(dataset, tmp_path / "run", *changes)

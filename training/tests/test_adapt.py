"""Adapting to photographs: what is accepted, what is learnt from it, what can be struck out."""

import json
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch
import trimesh

from mvtop_train.adapt import accept, exposures, gain, labels, learn, page, rounds
from mvtop_train.adapt.accept import Judge, Pose
from mvtop_train.adapt.exposures import Exposure
from mvtop_train.adapt.labels import Labels
from mvtop_train.data import batches, bop, objects, search
from mvtop_train.errors import UserError
from mvtop_train.network import config, losses
from mvtop_train.network.model import Mvtop
from mvtop_train.training import checkpoint

SIZE = 160, 120
K = np.array([[150.0, 0, 79.5], [0, 150, 59.5], [0, 0, 1]])
WEIGHTS = {"view_bias": -1.0, "view": {"detector": 1.0, "contour": 2.0}}


def box_of(number: int, name: str) -> tuple[objects.Object, trimesh.Trimesh]:
    mesh = trimesh.creation.box([0.1, 0.1, 0.1])
    return objects.from_mesh(mesh, number, name), mesh


NUT, BOLT = (box_of(number, name) for number, name in ((1, "nut"), (2, "bolt")))


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    root = tmp_path_factory.mktemp("data")
    objects.write(root, [NUT, BOLT])
    return root


def at(x: float, y: float = 0.0, z: float = 1.0, turn_deg: float = 0.0) -> np.ndarray:
    pose, angle = np.eye(4), np.deg2rad(turn_deg)
    pose[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    pose[:3, 3] = x, y, z
    return pose


def pose(place: np.ndarray, confidence: float = 0.95, obj=NUT[0], views: int = 3) -> Pose:
    return Pose("day", obj, place, confidence, views)


def camera(name: str, x: float = 0.0, **options):
    import mvtop

    stands = np.eye(4)
    stands[0, 3] = x
    return mvtop.Camera(K, SIZE, world_from_cam=stands, id=name, **options)


def rig_file(path, count: int = 3):
    import mvtop

    mvtop.Rig([camera(f"c{n}", 0.1 * n) for n in range(count)]).save(
        path / "rig.json", overwrite=True
    )
    return path / "rig.json"


def photograph(path, value: int = 90):
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.full((*SIZE[::-1], 3), value, np.uint8))


@pytest.fixture
def photos(tmp_path):
    """Six exposures of three cameras, one of which lacks an image."""
    for number in range(6):
        for name in ("c0", "c1", "c2"):
            if (number, name) != (1, "c2"):
                photograph(tmp_path / "photos" / f"e{number}" / f"{name}.png", 40 * number)
    return tmp_path / "photos"


def test_exposures_are_folders_of_images_named_after_cameras(photos, tmp_path):
    rig = rig_file(tmp_path)
    found = exposures.read(photos, rig, 2)
    assert [one.name for one in found] == [f"e{n}" for n in range(6)]
    assert list(found[1].paths) == ["c0", "c1"]
    images = found[3].images()
    assert list(images) == ["c0", "c1", "c2"] and images["c1"].shape == (120, 160, 3)
    assert images["c1"][0, 0, 0] == 120
    assert [one.name for one in exposures.read(photos, rig, 3)] == ["e0", "e2", "e3", "e4", "e5"]
    part = found[0].part([2, 0])
    assert [one.id for one in part.rig.cameras] == ["c2", "c0"]
    with pytest.raises(UserError, match="at least 4 images, got 3 at most; fix: .*--min-views 3"):
        exposures.read(photos, rig, 4)
    with pytest.raises(UserError, match="got none"):
        exposures.read(tmp_path, None, 2)


def test_exposures_of_scenes_do_not_know_what_is_annotated(tmp_path):
    folder = tmp_path / "scenes" / "000007"
    view = {"cam_K": K.ravel().tolist(), "cam_R_w2c": np.eye(3).ravel().tolist()}
    shots = {str(n): view | {"cam_t_w2c": [100.0 * n, 0, 0]} for n in (4, 9)}
    for n in (4, 9):
        photograph(folder / "rgb" / f"{n:06d}.png")
    (folder / "scene_camera.json").write_text(json.dumps(shots))
    (folder / "scene_gt.json").write_text(json.dumps({"4": [], "9": []}))
    (one,) = exposures.read(tmp_path / "scenes", None, 2)
    assert one.name == "000007" and [path.stem for path in one.paths.values()] == [
        "000004", "000009",
    ]  # fmt: skip
    assert exposures.read(folder, None, 2)[0].name == "000007"


def test_one_exposure_in_five_is_held_out_or_one_image_in_five(photos, tmp_path):
    found = exposures.read(photos, rig_file(tmp_path), 2)
    training, held = exposures.split(found, 2)
    assert [one.name for one in held] == ["e2"] and len(training) == 5
    assert exposures.split(found[:2], 2) == (found[:2], [])
    import mvtop

    cameras = [camera(f"c{n}", 0.1 * n) for n in range(12)]
    many = Exposure("day", mvtop.Rig(cameras), {one.id: photos for one in cameras})
    (training,), (held,) = exposures.split([many], 3)
    assert list(held.paths) == ["c2", "c7"] and len(training.paths) == 10
    assert {*held.paths} | {*training.paths} == {*many.paths}


def test_most_groups_must_agree_on_a_pose():
    near, turned = pose(at(0.001)), pose(at(0, turn_deg=30), 0.99)
    assert accept.consensus([pose(at(0), 0.92), near, turned]) == [near]
    assert accept.consensus([near, turned]) == []  # one against one
    assert accept.consensus([turned]) == [turned]
    other = pose(at(0.5))
    bolt = pose(at(0), obj=BOLT[0])
    assert set(map(id, accept.consensus([near, other, bolt]))) == set(map(id, (near, other, bolt)))


def test_groups_of_many_images_are_bounded():
    assert accept.groups_of(4) == [[0, 1, 2, 3]]
    groups = accept.groups_of(46)
    assert len(groups) == 23 and all(len(set(group)) == accept.MOST_VIEWS for group in groups)


def judged(*predictions, views: int = 2) -> Judge:
    """A judge whose estimator gives these predictions, one after the other."""
    judge = Judge.__new__(Judge)
    judge.known = {1: NUT[0], 2: BOLT[0]}
    judge.weights, judge.least, judge.views = {"refined": WEIGHTS}, 0.9, views
    left = iter(predictions)
    judge.estimator = SimpleNamespace(predict=lambda *_, **__: next(left))
    return judge


def found(place, contours, confidence=0.95, number: int = 1):
    views = [{"detector": 0.3, "contour": contour} for contour in contours]
    return SimpleNamespace(
        class_id=number, world_from_obj=place, confidence=confidence, refinement=True,
        evidence={"views": [dict.fromkeys(accept.VIEW_TERMS, 0.0) | view for view in views]},
    )  # fmt: skip


def prediction(*objects_, warnings=()):
    return SimpleNamespace(objects=list(objects_), warnings=list(warnings))


@pytest.fixture
def day(photos, tmp_path):
    rig = rig_file(tmp_path)
    return replace(exposures.read(photos, rig, 3)[0], name="day")


def test_views_speak_for_a_pose_where_their_log_odds_are_positive(day):
    """-1 + 0.3 + 2 x contour; with a box given -1 + 2 x contour. The third camera, which has the
    object outside of its image, gives no evidence."""
    left = at(-0.45)  # c0 has it at its border, c2 beyond
    judge = judged()
    told = judge._views(found(left, [0.4, 0.3]), day)
    shares = {
        one.id: accept.inside(accept.pixels_of(NUT[0].points, left, one), one)
        for one in day.rig.cameras
    }
    assert shares["c2"] < shares["c1"] < shares["c0"]
    assert told == {"c0": True, "c1": False}
    assert judge._views(found(left, [0.4, 0.6]), day, given=True) == {"c0": False, "c1": True}


def test_sure_poses_of_a_trusted_rig_are_accepted(day):
    sure = found(at(0), [0.5, 0.5, 0.5])
    few, unsure = found(at(0), [0.5, 0.1, 0.1]), found(at(0), [0.5] * 3, confidence=0.8)
    for one, warnings, accepted in (
        (sure, (), 1), (few, (), 0), (unsure, (), 0), (sure, ("lines_miss",), 0),
    ):  # fmt: skip
        mine, others = judged(prediction(one, warnings=warnings)).poses(day)
        assert (len(mine), len(others)) == (accepted, 1 - accepted)


def test_images_in_which_an_accepted_object_is_not_seen_are_told(day):
    other = pose(at(0.1), obj=BOLT[0])
    told = prediction(found(at(0), [0.9, 0.2, 0.9]), found(at(0.2), [0.9] * 3, number=2))
    seen = judged(told).seen_by(day, [pose(at(0)), other])
    assert seen == {"c0": [True, False], "c1": [False, False], "c2": [True, False]}


class Suspicious:
    """In place of a detector: a box where nothing is known, and one at the nut."""

    names, threshold = ["nut", "bolt"], 0.5

    def __init__(self, bundle=None):
        pass

    def __call__(self, rgb):
        boxes = torch.tensor([[10.0, 80, 40, 110], [71, 51, 88, 68], [100, 90, 120, 110]])
        return boxes, torch.tensor([0.2, 0.9, 0.05]), torch.tensor([0, 1, 0])


@pytest.fixture
def written(day, data, tmp_path):
    """Of two accepted boxes the second stands behind the first; c1 does not show the first; a third
    is not accepted."""
    nut, bolt = pose(at(0)), pose(at(0.07, z=1.15), obj=BOLT[0])
    known = Labels(
        {"day": [nut, bolt]}, {"day": [pose(at(0.25), 0.3)]},
        {"day": {"c0": [True, True], "c1": [False, True], "c2": [True, True]}},
    )  # fmt: skip
    root = tmp_path / "photographs"
    labels.write(root, [day], known, data, Suspicious())
    return root, known


def test_labels_are_where_the_poses_project(written):
    root, known = written
    first, second, third = bop.read_images(root / "train" / "000000")
    assert [one.obj_id for one in first.instances] == [1, 2]
    assert [one.obj_id for one in second.instances] == [2]
    code, owners = bop.read_coords(first, SIZE[::-1])
    # The nut's near face: 0.1 m at 0.95 m.
    v, u = np.nonzero(owners == 1)
    np.testing.assert_allclose([np.ptp(u) + 1, np.ptp(v) + 1], 150 * 0.1 / 0.95, atol=1.5)
    middle = (code[59, 79].astype(float) - 128) / 120 * NUT[0].extent_m
    # Half a pixel beside the axis: 0.5 / 150 of 0.95 m.
    np.testing.assert_allclose(middle, [-0.0032, -0.0032, -0.05], atol=5e-4)
    nut, bolt = first.instances
    assert nut.visible_share == pytest.approx(1.0)
    assert 0 < bolt.visible_share < 0.7 and (owners == 2).any()  # mostly behind the nut
    np.testing.assert_allclose(nut.cam_from_obj, at(0), atol=1e-9)
    # What is not accepted, not seen where it should be, or suspected; but not what lies on the nut.
    assert len(first.unsure) == 2 and len(second.unsure) == 4
    assert [10.0, 80, 40, 110] in first.unsure.tolist()
    assert owners[95, 25] == bop.OTHER and owners[5, 5] == 0


def test_the_detector_learns_nothing_where_an_object_may_be(written):
    root, _ = written
    image = bop.read_images(root / "train" / "000000")[0]
    network = config.preset("lite", objects.classes_of(NUT[0], BOLT[0]), width=160, height=128)
    searches = search.Searches(network, (NUT[0], BOLT[0]))
    made = searches.make(image, np.random.default_rng(0), augment=False)
    assert sorted(made["search_class"][:4].tolist()) == [-1, -1, 0, 1]
    (row,) = np.flatnonzero((abs(made["search_boxes"] - [10, 84, 40, 114]) < 1).all(1))
    assert made["search_class"][row] == -1
    truth, index = (torch.from_numpy(made[f"search_{x}"])[None] for x in ("boxes", "class"))
    quiet, boxes = torch.full((1, 2, 16, 20), -4.0), torch.zeros(1, 4, 16, 20)
    loud = quiet.clone()
    loud[0, :, 12, 3] = 3.0  # in the middle of the suspected box, which lies 4 px lower here
    torch.testing.assert_close(
        losses.detection_loss(loud, boxes, truth, index, 8),
        losses.detection_loss(quiet, boxes, truth, index, 8),
    )


def test_lenses_are_straightened():
    bent = camera("c0", distortion=(0.5, 0, 0, 0))
    rgb = np.zeros((*SIZE[::-1], 3), np.uint8)
    point = np.array([0.3, 0.2, 1.0])
    u, v = bent.project(point)
    cv2.circle(rgb, (round(u), round(v)), 2, (255, 255, 255), -1)
    straight, picture = labels.straight(bent, rgb)
    y, x = np.nonzero(picture[..., 0] > 128)
    np.testing.assert_allclose([x.mean(), y.mean()], straight.project(point), atol=1.0)
    assert np.hypot(*(straight.project(point) - [u, v])) > 2
    plain = camera("c0")
    assert labels.straight(plain, rgb) == (plain, rgb)


def test_lines_can_be_struck_out(written, tmp_path):
    root, known = written
    out = tmp_path / "out"
    page.write(out, known, [], root)
    assert page.struck(out, (NUT[0], BOLT[0])) == []
    text = (out / page.PAGE).read_text()
    assert text.count("<img") == 5 and text.count("<h2>") == 2
    lines = (out / page.LIST).read_text().splitlines()
    nut = next(n for n, line in enumerate(lines) if "\tnut\t" in line)
    lines[nut] = "#" + lines[nut]
    (out / page.LIST).write_text("\n".join(lines))
    (gone,) = page.struck(out, (NUT[0], BOLT[0]))
    assert gone.obj.name == "nut" and gone.same_object(known.accepted["day"][0])
    page.write(out, known, [gone], root)
    assert len(page.struck(out, (NUT[0], BOLT[0]))) == 1, "it stays struck out"
    (out / page.LIST).write_text("# nut\n")
    with pytest.raises(UserError, match="line 1: expected a line of this list"):
        page.struck(out, (NUT[0], BOLT[0]))


def test_what_is_struck_out_is_not_accepted_again(day):
    judge = SimpleNamespace(
        poses=lambda one: ([pose(at(0)), pose(at(0.5))], []),
        seen_by=lambda one, poses: {"c0": [True] * len(poses), "c1": [False] * len(poses)},
    )
    told = labels.of(judge, [day], [pose(at(0.002), 0.0)])
    assert [one.world_from_obj[0, 3] for one in told.accepted["day"]] == [0.5]
    assert len(told.others["day"]) == 2 and told.count == 1
    # What was accepted before stays, in its pose; it is not accepted twice.
    before = Labels({"day": [pose(at(0.501))]}, {}, {})
    again = labels.of(judge, [day], [], before)
    assert [one.world_from_obj[0, 3] for one in again.accepted["day"]] == [0.501, 0.0]


def test_photographs_make_up_their_share_of_what_is_drawn():
    def scenes(things: int, images: int):
        listed = {"training": [["x"]] * things, "images": ["y"] * images}
        return SimpleNamespace(objects=(), **listed)

    both = batches.Mixed(scenes(90, 100), scenes(3, 10), things=0.25, images=0.5)
    assert len(both.training) == 90 + 30 and len(both.images) == 100 + 100
    assert len(batches.Mixed(scenes(1, 1), scenes(3, 10), 0.25, 0.5).training) == 4


def test_gain_is_measured_in_pairs_and_in_all_views(day):
    assert gain._parts(5, 2) == [[0, 3], [1, 4]] and gain._parts(4, 0) == [[0, 1, 2, 3]]
    there = gain.truth_of([judged()], [day], {"day": [pose(at(0)), pose(at(0.5))]}, [pose(at(0.5))])
    assert [one.world_from_obj[0, 3] for one in there["day"]] == [0]
    first, second = (judged(prediction(found(at(x), [0.9] * 3))) for x in (0, 0.001))
    (agreed,) = gain.truth_of([first, second], [day], {}, [])["day"]
    assert agreed.world_from_obj[0, 3] in (0, 0.001)
    rows = {key: 0.5 for key, _ in gain.ROWS}
    assert "50 %" in gain.table(rows, rows | {"contour": None})


def bundle_of(folder, preset: str = "lite", **more):
    folder.mkdir(parents=True)
    classes = [{"name": "nut"}, {"name": "bolt"}]
    about = {"preset": preset, "classes": classes, "provenance": {"trained_steps": 7}, **more}
    (folder / "model.json").write_text(json.dumps(about))
    return folder


def test_a_bundle_s_run_is_known_or_asked_for(tmp_path, data, monkeypatch):
    bundle = bundle_of(tmp_path / "run" / "bundle")
    with pytest.raises(UserError, match="fix: --data"):
        learn.source_of(bundle, None, {"data": None}, [])
    source = learn.source_of(bundle, None, {"data": str(data), "held_out": 3, "lr": None}, ["lr=1"])
    assert (source.data, source.weights, source.fields["held_out"]) == (data, None, 3)
    assert [one.name for one in source.known()] == ["nut", "bolt"]
    (tmp_path / "run" / "config.toml").write_text('data = "of run"\nsteps = 1\nheld_out = 9\n')
    (tmp_path / "run" / "weights.pt").write_text("")
    steps = {"is": 7}
    monkeypatch.setattr(learn.checkpoint, "load_weights", lambda path: (None, None, steps["is"]))
    source = learn.source_of(bundle, None, {"data": None, "minutes": 5.0}, [])
    assert str(source.data) == "of run" and source.weights == tmp_path / "run" / "weights.pt"
    steps["is"] = 8
    assert learn.source_of(bundle, None, {"data": None}, []).weights is None
    with pytest.raises(UserError, match="expected weights of 7 steps, as the bundle's, got 8"):
        learn.source_of(bundle, tmp_path / "w.pt", {"data": None}, [])
    with pytest.raises(UserError, match="expected a network of preset lite"):
        learn.source_of(bundle_of(tmp_path / "small", "small"), None, {}, [])


def test_a_bundle_without_confidences_is_refused(tmp_path):
    with pytest.raises(UserError, match="expected a calibrated bundle"):
        Judge(bundle_of(tmp_path / "bundle"), (), 0.9, 3)


@pytest.fixture
def adaptation(tmp_path, photos, data, monkeypatch):
    """Runs all but what networks do; the images that are accepted after each round are given."""
    bundle = bundle_of(tmp_path / "run" / "bundle")
    (tmp_path / "w.pt").write_bytes(b"weights")
    trained = []

    def train(settings, photographs, folder):
        trained.append(settings)
        folder.mkdir(parents=True)
        (folder / "weights.pt").write_bytes(b"learnt")
        return folder / "weights.pt"

    def of_bundle(source, settings, weights, made):
        bundle_of(made)

    monkeypatch.setattr(learn, "train", train)
    monkeypatch.setattr(learn, "interim", of_bundle)
    calibrated = [True]

    def final(settings, weights, made, scenes) -> bool:
        bundle_of(made)
        return calibrated[0]

    monkeypatch.setattr(learn, "final", final)
    monkeypatch.setattr(learn, "weights_of", lambda source, work: tmp_path / "w.pt")
    network = config.preset("lite", objects.classes_of(NUT[0], BOLT[0]))
    monkeypatch.setattr(learn.checkpoint, "load_weights", lambda path: (None, network, 7))
    monkeypatch.setattr(rounds, "Judge", lambda *_: None)
    monkeypatch.setattr(rounds, "Detector", Suspicious)
    told = {"detector": 0.5, "detector_near": 0.5, "found_2": 0.5, "right_2": 0.5}
    monkeypatch.setattr(gain, "truth_of", lambda *_: {})
    monkeypatch.setattr(
        gain, "measured", lambda *_: told | {"found": 1, "right": 1, "contour": None}
    )

    def run(counts: list[int], **options) -> list:
        left = iter(counts)

        def of(judge, shown, struck, before=None):
            images = next(left)
            seen = [{f"{n}": [n < images] for n in range(99)}, {}]
            names = [shown[0].name, *(one.name for one in shown[1:])]
            accepted = {name: [] for name in names} | {"e0": [replace(pose(at(0)), scene="e0")]}
            return Labels(accepted, {name: [] for name in names}, {"e0": seen[0]})

        monkeypatch.setattr(labels, "of", of)
        monkeypatch.setattr(labels, "write", lambda *_: None)
        trained.clear()
        asked = {"data": str(data), "minutes": 40.0}
        source = learn.source_of(bundle, None, asked, [])
        given = {"minutes": 40.0, "confidence": 0.9, "views": 3} | options
        rig = rig_file(tmp_path)
        rounds.run(source, rounds.Options(photos, rig, tmp_path / "out", **given))
        return list(trained)

    run.calibrated = calibrated
    return run


def test_rounds_end_where_nothing_new_is_accepted(adaptation, tmp_path, capsys):
    first, second = adaptation([30, 30])
    assert first.init == str(tmp_path / "w.pt") and second.init.endswith("round-1/weights.pt")
    assert first.seed != second.seed
    # Half of what is left before export and calibration, then all of it.
    assert second.minutes == pytest.approx(2 * first.minutes, rel=0.01)
    out = tmp_path / "out"
    assert (out / "bundle" / "model.json").exists() and (out / "weights.pt").exists()
    assert json.loads((out / "gain.json").read_text())["after"]["detector"] == 0.5
    assert (out / "config.toml").exists() and "held out" in capsys.readouterr().out


def test_rounds_go_on_while_more_is_accepted(adaptation, tmp_path):
    assert len(adaptation([30, 40, 41])) == 3
    with pytest.raises(UserError, match="expected no such folder, got one; fix: --force"):
        adaptation([30, 30])
    assert len(adaptation([30, 30], force=True)) == 2


def test_too_little_to_learn_from_is_refused(adaptation, tmp_path):
    with pytest.raises(UserError, match="in at least 20 images, .* got 1 poses in 19"):
        adaptation([19])
    assert adaptation([30], only_show=True) == []
    assert not (tmp_path / "out" / "bundle").exists()
    with pytest.raises(UserError, match="--minutes: expected more than"):
        adaptation([30], minutes=2.0)
    with pytest.raises(UserError, match="at least 4 images"):
        adaptation([30], views=4)


def test_where_it_cannot_be_calibrated_the_bundle_is_kept_and_that_is_told(
    adaptation, tmp_path, capsys
):
    adaptation.calibrated[0] = False
    adaptation([30, 30])
    assert "is not calibrated" in capsys.readouterr().out
    assert (tmp_path / "out" / "bundle").exists() and not (tmp_path / "out" / "gain.json").exists()


def test_calibration_takes_a_quarter_of_the_time():
    assert rounds.calibration_scenes(20, 100) == 83
    assert rounds.calibration_scenes(20, 60) == 60
    assert rounds.calibration_scenes(1, 60) == rounds.LEAST_SCENES


def test_a_network_is_trained_on_both(written, data, tmp_path):
    """Two steps of a tiny network; the photographs serve as rendered scenes, too."""
    root, _ = written
    shots = tmp_path / "data"
    shots.mkdir()
    (shots / "models").symlink_to(data / "models")
    (shots / "models_eval").symlink_to(data / "models_eval")
    (shots / "train").symlink_to(root / "train")
    known = objects.classes_of(NUT[0], BOLT[0])
    tiny = config.preset("lite", known, width=128, height=96, closeup=64)
    model = Mvtop(tiny)
    checkpoint.save_weights(model, 1, 1, tmp_path / "w.pt")
    fields = learn.TRAINING | {
        "data": str(shots), "held_out": 0, "minutes": 9.0, "steps": 2, "images": 4, "searched": 2,
        "workers": 0, "precision": "fp32",
    }  # fmt: skip
    settings = learn.Source(tmp_path, None, fields).settings(tmp_path / "w.pt")
    assert (settings.network.width, settings.network.closeup) == (128, 64)
    weights = learn.train(settings, root, tmp_path / "round")
    trained, shape, steps = checkpoint.load_weights(weights)
    assert steps == 2 and shape == tiny
    told = [json.loads(line) for line in (tmp_path / "round" / "log.jsonl").open()]
    assert all(np.isfinite(told[-1][name]) for name in ("loss", "detection", "coordinates"))
    score = trained.features.detector.score.weight
    assert not torch.equal(score, model.features.detector.score.weight.half().float())

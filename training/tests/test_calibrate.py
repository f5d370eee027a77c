"""What is fitted for a bundle: weights of the evidence, limits of the rig, the least confidence."""

import json
import shutil
import warnings
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import mvtop
import numpy as np
import pytest

from mvtop_train import calibrate as command
from mvtop_train import description
from mvtop_train.data import bop, objects
from mvtop_train.errors import UserError
from mvtop_train.evaluation import statistics
from mvtop_train.training import calibrate, evidence, heldout
from mvtop_train.training.evidence import POSE_TERMS, VIEW_TERMS, Gathered, Judged

TINY = Path(__file__).parents[2] / "fixtures" / "tiny"
VIEW_WEIGHTS = dict(zip(VIEW_TERMS, (2.0, 4.0, 6.0, 3.0, 1.5, 5.0), strict=True))
POSE_WEIGHTS = dict(zip(POSE_TERMS, (1.0, -0.8, -0.5, -0.3, -1.0, -0.7, -0.9, -1.2), strict=True))
WEIGHTS = {
    "bias": 0.5, "view_bias": -6.0, "view": VIEW_WEIGHTS, "pose": POSE_WEIGHTS, "bound": 4.0,
    "correlation": 0.6,
}  # fmt: skip


def poses(count: int, weights: dict = WEIGHTS, seed: int = 0, refined: bool = True) -> list[Judged]:
    """Right with the odds that the core has of these weights."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        n = int(rng.integers(1, 5))
        pose = rng.normal(size=len(POSE_TERMS))
        pose[list(POSE_TERMS).index("views")] = np.log(n)
        seen = rng.random((n, len(VIEW_TERMS)))
        one = Judged(rng.uniform(0.6, 1, n), seen, pose, refined, False, True, n, False)
        odds = calibrate.log_odds(weights, one)
        found.append(replace(one, right=bool(rng.random() < 1 / (1 + np.exp(-odds)))))
    return found


def rig_of(camera=0.0, scale=0.0, box=0.0, confirmed=0, unconfirmed=0):
    return SimpleNamespace(
        camera_deviation=camera, scale_deviation=scale, box_deviation=box,
        confirmed=confirmed, unconfirmed=unconfirmed,
    )  # fmt: skip


def own_limits():
    """The core's."""
    return {name: evidence.defaults()[name] for name in description.FITTED["rig"]}


@pytest.fixture
def tiny(tmp_path):
    """A copy of the bundle that may be changed."""
    bundle = tmp_path / "bundle"
    bundle.mkdir()
    for name in ("model.json", *description.read(TINY)["files"]):
        shutil.copy(TINY / name, bundle / name)
    return bundle


def predicted(bundle: Path, *ids: str):
    rig = mvtop.Rig.load(TINY / "sample" / "rig.json")
    images = {name: TINY / "sample" / f"{name}.png" for name in ids}
    estimator = mvtop.Estimator.load(bundle, inference={"search.min_confidence": 0.0})
    return estimator.predict(images, rig)


def judged(one, **changes) -> Judged:
    about = dict(refined=False, right=False, exists=True, images=2, disturbed=False) | changes
    return Judged(*evidence.terms(one.evidence), **about)


def test_weights_are_found_again():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fitted = calibrate.fit(poses(20_000), less_texture=0.0)
    for name, weight in POSE_WEIGHTS.items():
        # The number of views also acts by the correlation, each in place of the other.
        within = 0.5 if name == "views" else 0.15
        assert fitted["pose"][name] == pytest.approx(weight, abs=within), name
    for name, weight in VIEW_WEIGHTS.items():
        assert fitted["view"][name] == pytest.approx(weight, rel=0.2), name
    assert fitted["correlation"] == pytest.approx(0.6, abs=0.2)
    others = poses(5000, seed=1)
    expected, got = (
        np.array([calibrate.log_odds(weights, one) for one in others])
        for weights in (WEIGHTS, fitted)
    )
    assert abs(got - expected).mean() < 0.15
    confidence = 1 / (1 + np.exp(-got))
    _, error = statistics.reliability(confidence, np.array([one.right for one in others]))
    assert error < 0.03


def test_weights_have_the_sign_of_what_their_evidence_means():
    """Even where the poses say the opposite, which they do by chance or by what they are of."""
    opposite = {kind: {name: -x for name, x in WEIGHTS[kind].items()} for kind in ("view", "pose")}
    fitted = calibrate.fit(poses(3000, WEIGHTS | opposite | {"view_bias": 6.0}))
    for kind, signs in (("view", VIEW_TERMS), ("pose", POSE_TERMS)):
        for name, sign in signs.items():
            assert sign * fitted[kind][name] >= 0, name
            # The number of views goes with what they show.
            assert name == "views" or abs(fitted[kind][name]) < 0.2, name


def test_texture_that_agrees_less_counts_less():
    found = poses(5000)
    whole, faded = (calibrate.fit(found, less_texture=x)["view"]["texture"] for x in (0.0, 0.9))
    assert faded < 0.9 * whole


def test_too_few_poses_have_no_weights():

    def of(right: int, wrong: int):
        found = poses(right + wrong)
        return calibrate.fit([replace(one, right=n < right) for n, one in enumerate(found)])

    assert of(50, 50) and of(10, 90) and of(90, 10)
    assert of(50, 49) is of(9, 191) is of(191, 9) is None


def test_poses_of_which_none_is_right_are_weighed_by_what_exists():
    found = [replace(one, exists=one.right, right=False) for one in poses(400)]
    assert calibrate.fit(found) is None
    weights = calibrate.fit_to_existence(found)
    odds = np.array([calibrate.log_odds(weights, one) for one in found])
    exists = np.array([one.exists for one in found])
    assert odds[exists].mean() > odds[~exists].mean() + 0.5
    # By hand: half a right pose of 401.
    assert (1 / (1 + np.exp(-odds))).mean() == pytest.approx(0.5 / 401, rel=0.01)
    assert calibrate.fit_to_existence(found[:50]) is None


def test_log_odds_are_the_cores(tiny):
    scorer = {"refined": WEIGHTS | {"bias": 9.0}, "unrefined": WEIGHTS}
    calibrate.put(tiny, scorer, own_limits(), 0.0, None, {})
    for ids in (["cam0"], ["cam0", "cam1"], ["cam0", "cam1", "cam2", "cam3"]):
        found = predicted(tiny, *ids).objects
        assert found
        for one in found:
            ours = judged(one)
            odds = calibrate.log_odds(WEIGHTS, ours)
            assert odds == pytest.approx(one.evidence["log_odds"], abs=1e-6)
            assert calibrate.confidence(scorer, ours) == pytest.approx(one.confidence, abs=1e-6)


def test_a_rig_s_deviation_is_the_cores(tiny):
    """The fixture has no meshes: boxes alone say how well the rig fits."""
    half = {name: limit / 2 for name, limit in own_limits().items()}
    before = predicted(tiny, "cam0", "cam1", "cam2", "cam3")
    calibrate.put(tiny, {"refined": WEIGHTS, "unrefined": WEIGHTS}, half, 0.0, None, {})
    after = predicted(tiny, "cam0", "cam1", "cam2", "cam3")
    for prediction, limits in ((before, own_limits()), (after, half)):
        rig = prediction.rig_consistency
        assert evidence.by_boxes(rig)
        assert evidence.deviation(rig, limits) == pytest.approx(rig.deviation)
        own = judged(prediction.objects[0], rig=rig)
        assert evidence.with_limits(own, limits).pose == pytest.approx(own.pose)
    alone = judged(before.objects[0])
    assert evidence.with_limits(alone, half) is alone


def test_a_rig_s_deviation_by_hand():
    limits = {
        "max_camera_deviation": 2.0, "max_scale_deviation": 4.0, "max_box_deviation": 5.0,
        "max_contradiction": 2.0, "unconfirmed_true": 0.1, "unconfirmed_wrong": 0.8,
    }  # fmt: skip
    assert evidence.deviation(rig_of(camera=3.0, scale=4.0), limits) == 1.5
    assert evidence.deviation(rig_of(box=50.0, unconfirmed=1), limits) == 10.0
    # ln 8 for each that is not confirmed, ln (2 / 9) for each that is.
    contradicted = rig_of(camera=1.0, confirmed=1, unconfirmed=3)
    by_hand = (3 * np.log(8) + np.log(2 / 9)) / 2
    assert evidence.deviation(contradicted, limits) == pytest.approx(by_hand)


def test_a_hundredth_of_the_groups_exceeds_the_limits():
    values = [*np.linspace(0.005, 0.995, 198), 7.0, 9.0]
    found = calibrate.limits([rig_of(camera=x, scale=0.0) for x in values], [])
    assert found["max_camera_deviation"] == calibrate.CHANCE["max_camera_deviation"]
    by_camera = [rig_of(camera=10 * x, scale=x) for x in values]  # two of 200
    found = calibrate.limits(by_camera, [])
    assert found["max_camera_deviation"] == pytest.approx(9.95)
    boxes = [rig_of(box=x) for x in values]
    assert calibrate.limits([], boxes[:199])["max_box_deviation"] == 1.0  # one of 199
    assert calibrate.limits([], boxes[-99:])["max_box_deviation"] == 9.0  # none of 99
    # Of too few, the core's own.
    assert calibrate.limits([], boxes[-19:]) == own_limits()
    # Rigs that always fit leave room for chance.
    always = calibrate.limits([rig_of()] * 50, [rig_of()] * 50)
    assert always == calibrate.CHANCE | {"unconfirmed_true": own_limits()["unconfirmed_true"]}


def test_the_share_of_objects_that_one_camera_shows_alone_is_counted():
    def share(confirmed, unconfirmed):
        rigs = [rig_of(confirmed=confirmed, unconfirmed=unconfirmed)] * 10
        return calibrate.limits(rigs, [])["unconfirmed_true"]

    assert share(3, 1) == 0.25
    assert share(1, 0) == own_limits()["unconfirmed_true"]  # of too few
    assert (share(90, 0), share(1, 9)) == calibrate.UNCONFIRMED


def test_of_what_is_as_confident_two_percent_does_not_exist():
    confidence = np.linspace(0.9999, 0.0, 201)
    exists = np.ones(201, bool)
    assert calibrate.least_confidence(confidence, exists) == 0.0
    exists[[60, 80, 90, 100, 110]] = False  # one of 61 to 80, then more than 2 %
    # Of the 80th, 0.9999 * 121 / 200 rounded down.
    assert calibrate.least_confidence(confidence[::-1], exists[::-1]) == 0.604
    assert calibrate.least_confidence(confidence, ~exists) == 0.5
    assert calibrate.least_confidence(np.zeros(0), np.zeros(0, bool)) == 0.5
    # All that is kept is kept after rounding, also just below 1.
    assert calibrate.least_confidence(np.full(5, 0.99996), np.ones(5, bool)) == 0.999


def test_calibration_error_by_hand():
    confidence = np.repeat([0.1, 0.9], 50)
    right = np.r_[np.zeros(40), np.ones(10), np.ones(50)]  # 20 % and 100 %
    rows, error = statistics.reliability(confidence, right)
    assert len(rows) == 10
    # Each bin has ten poses of one kind; of the first five, one holds all ten right ones.
    assert error == pytest.approx((4 * 0.1 + 0.9 + 5 * 0.1) / 10)


def test_what_is_written_is_what_the_core_loads(tiny):
    about = description.read(tiny)
    about["inference"] = {"search": {"settled": 0.8}, "rig": {"unconfirmed_true": 0.3}}
    about["detector"] |= {"support_threshold": 0.1, "most_deviation": 4.0, "print_threshold": 0.2}
    about["confidence"] = {"bias": 1.0}
    description.write(tiny, about)
    with pytest.raises(mvtop.Error, match="mvtop-train calibrate"):  # of an earlier pipeline
        mvtop.Estimator.load(tiny)
    rig = own_limits() | {"max_box_deviation": 3.5}
    fitted = calibrate.fit(poses(300))
    scorer = {"refined": fitted, "unrefined": fitted}
    calibrate.put(tiny, scorer, rig, 0.25, -5.0, {"score_threshold": 0.4, "agree_threshold": 0.2})
    mvtop.Estimator.load(tiny)
    written = description.read(tiny)
    search = {"settled": 0.8, "min_confidence": 0.25, "min_initial_log_odds": -5.0}
    assert written["inference"] == {"rig": rig, "search": search}
    assert written["scorer"] == {"within_deg": 5.0, "within_m": 0.005, **scorer}
    assert written["pipeline_version"] == 2 and "confidence" not in written
    assert written["detector"] == {"score_threshold": 0.4, "agree_threshold": 0.2, "nms_iou": 0.5}
    plain = description.uncalibrated(written)
    assert plain["inference"] == {"search": {"settled": 0.8}}
    assert not {"scorer", "pipeline_version"} & set(plain)


def scene(images: int) -> list[bop.Image]:
    """The fixture's sample."""
    truth = json.loads((TINY / "sample" / "truth.json").read_text())
    rig = mvtop.Rig.load(TINY / "sample" / "rig.json")
    found = []
    for n, camera in enumerate(rig.cameras[:images]):
        cam_from_world = np.linalg.inv(camera.world_from_cam)
        place = np.array(truth["objects"][0]["T_world_obj"])
        things = [bop.Instance(objects.ball().id, cam_from_world @ place, None)]
        path = TINY / "sample" / f"{camera.id}.png"
        found.append(bop.Image(n, path, camera.K, cam_from_world, things))
    return found


def test_poses_of_groups_are_gathered(tiny):
    found = evidence.gathered(
        tiny, [scene(4)], (objects.ball(),), "poses", disturbed=0.0,
        inference={"search.min_confidence": 0.0},
    )  # fmt: skip
    counts = {one.images for one in found.poses}
    assert counts <= {1, 2, 3, 4} and 4 in counts
    # One group of four, one of three, two of two.
    assert len(found.rigs) == 4 and found.failed == 0
    assert all(len(one.views) == len(one.visible) <= one.images for one in found.poses)
    assert any(one.exists for one in found.poses)


def test_groups_that_fail_are_counted(tiny, monkeypatch):
    class Hopeless:
        def predict(self, *args, **options):
            raise mvtop.Error("poses that cannot be")

    monkeypatch.setattr(mvtop.Estimator, "load", lambda *args, **options: Hopeless())
    found = evidence.gathered(tiny, [scene(2)], (), "poses")
    assert found == Gathered(failed=3)


def test_too_few_poses_and_interrupts_leave_the_bundle_as_it_is(tiny, monkeypatch):
    before = (tiny / "model.json").read_bytes()
    assert not calibrate.calibrate(tiny, [scene(2)], (objects.ball(),))

    def interrupted(*args, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(calibrate, "fit", interrupted)
    with pytest.raises(KeyboardInterrupt):
        calibrate.calibrate(tiny, [scene(2)], (objects.ball(),), {"score_threshold": 0.2})
    assert (tiny / "model.json").read_bytes() == before
    assert not list(tiny.glob("*.part"))


@pytest.mark.parametrize("refined", [True, False])
def test_all_is_fitted_and_written_at_once(tiny, monkeypatch, refined):
    asked = []

    def gathered(bundle, scenes, known, name, *, refine=None, inference):
        about = description.read(bundle)
        assert bundle != tiny and about["detector"]["score_threshold"] == 0.45
        # The second pass of refined poses is ranked by what the first one gave.
        assert ("scorer" in about) == (name == "refined, second pass")
        assert inference == {"search.min_confidence": 0.0, "search.min_initial_log_odds": None}
        asked.append(refine)
        found = poses(400, seed=refine is None, refined=refined and refine is None)
        if refine is None:
            found += poses(20, seed=2, refined=False)
        return Gathered(found, [rig_of(box=2.0)] * 20 + [rig_of(camera=5.0)] * 20)

    monkeypatch.setattr(calibrate, "gathered", gathered)
    for _ in range(2):  # the second time the bundle is calibrated already
        assert calibrate.calibrate(tiny, [], (), {"score_threshold": 0.45})
    assert asked == ([False, None, None] if refined else [False, None]) * 2
    written = description.read(tiny)
    assert written["inference"]["rig"]["max_box_deviation"] == 2.0
    assert written["inference"]["rig"]["max_camera_deviation"] == 5.0
    # All objects exist: the least confidence of any.
    assert 0 < written["inference"]["search"]["min_confidence"] < 0.5  # which it is of no pose
    same = written["scorer"]["refined"] == written["scorer"]["unrefined"]
    assert same != refined
    mvtop.Estimator.load(tiny)


def test_a_first_pass_of_too_few_poses_takes_all_scenes(tiny, monkeypatch):
    asked = []

    def gathered(bundle, scenes, known, name, *, refine=None, inference):
        asked.append((name, len(scenes)))
        found = poses(30 * len(scenes), seed=len(asked), refined=refine is None)
        return Gathered(found, [rig_of()] * 20)

    monkeypatch.setattr(calibrate, "gathered", gathered)
    assert calibrate.calibrate(tiny, [scene(2)] * 6, (objects.ball(),))
    assert asked == [
        ("unrefined poses", 6), ("refined, first pass", 2), ("refined, first pass", 6),
        ("refined, second pass", 6),
    ]  # fmt: skip


def test_groups_are_of_one_scene_each():
    def images(name, count):
        path = Path(name)
        return [bop.Image(n, path / f"{n}.png", np.eye(3), np.eye(4), []) for n in range(count)]

    groups = evidence.groups_of([images("a", 5), images("b", 1)])
    assert [[one.number for one in group] for group in groups] == [
        [0], [1], [2], [3], [4], [0, 1], [2, 3], [0, 1, 2], [0, 1, 2, 3], [0],
    ]  # fmt: skip


def test_cameras_may_be_in_one_housing(monkeypatch):
    monkeypatch.setattr(bop, "read_rgb", lambda path: np.zeros((48, 64, 3), np.uint8))
    k, beside = np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]]), np.eye(4)
    beside[0, 3] = -0.001
    images = [bop.Image(0, Path(), k, pose, []) for pose in (np.eye(4), beside)]
    rig, _ = bop.rig_of(images)
    assert rig.cameras[1].world_from_cam[0, 3] == pytest.approx(0.001)
    off = evidence.moved(rig, np.random.default_rng(0)).cameras
    assert np.array_equal(off[0].world_from_cam, np.eye(4))
    shift = np.linalg.norm((off[1].world_from_cam - rig.cameras[1].world_from_cam)[:3, 3])
    assert 0 < shift <= evidence.MAX_SHIFT_M


def test_images_are_grouped_by_scene(tmp_path):
    def image(scene, number):
        path = tmp_path / scene / "rgb" / f"{number}.jpg"
        return bop.Image(number, path, np.eye(3), np.eye(4), [])

    scenes = bop.scenes_of([image("1", 0), image("1", 1), image("2", 0)])
    assert [[one.number for one in scene] for scene in scenes] == [[0, 1], [0]]


def test_errors_are_of_the_nearest_object_of_the_class():
    ball = objects.ball()

    def pose(deg: float, mm: float):
        out = np.eye(4)
        c, s = np.cos(np.radians(deg)), np.sin(np.radians(deg))
        out[:2, :2] = [[c, -s], [s, c]]
        out[0, 3] = mm / 1e3
        return out

    truth = [(ball.id, pose(0, 0)), (ball.id, pose(0, 60)), (ball.id + 1, pose(0, 4))]
    assert evidence.nearest(pose(10, 4), truth, ball) == pytest.approx((10, 0.004), abs=1e-4)
    assert evidence.nearest(pose(0, 57), truth, ball) == pytest.approx((0, 0.003), abs=1e-4)
    assert evidence.nearest(pose(0, 500), truth, ball) == (np.inf, np.inf)


def test_an_object_of_several_images_is_one(tiny):
    truth = evidence.true_poses(scene(4), {objects.ball().id: objects.ball()})
    assert len(truth) == 1
    assert evidence.true_poses(scene(4), {}) == []


def test_changed_images_are_images():
    image = np.random.default_rng(0).integers(0, 256, (12, 16, 3)).astype(np.uint8)
    for seed in range(8):
        other = evidence.changed(image, np.random.default_rng(seed))
        assert other.shape == image.shape and other.dtype == np.uint8
        assert not np.array_equal(other, image)


def test_another_split_needs_a_calibrated_bundle_and_is_told_by_views(tiny, monkeypatch, capsys):
    args = SimpleNamespace(bundle=tiny, data=Path(), split="test", held_out=1)
    with pytest.raises(UserError, match="expected a calibrated bundle"):
        command.show(args)
    calibrate.put(tiny, {"refined": WEIGHTS, "unrefined": WEIGHTS}, own_limits(), 0.0, None, {})
    monkeypatch.setattr(heldout, "scenes", lambda args: [])
    monkeypatch.setattr(objects, "read_all", lambda data: ())
    scorer = {"refined": WEIGHTS}
    found = [replace(one, confidence=calibrate.confidence(scorer, one)) for one in poses(400)]
    found = [one for one in found if one.images != 3 or one.right][:400]
    rigs = [SimpleNamespace(deviation=x) for x in (0.5, 1.5)]
    monkeypatch.setattr(evidence, "gathered", lambda *args, **options: Gathered(found, rigs))
    before = (tiny / "model.json").read_bytes()
    command.show(args)
    told = capsys.readouterr().out
    assert all(f"{n} views: " in told for n in evidence.VIEWS) and "AUROC 0." in told
    assert "AUROC -, calibration error" in told  # of three views all are right
    assert told.endswith("rigs that are doubted, though true: 1 of 2\n")
    assert (tiny / "model.json").read_bytes() == before


def test_thresholds_are_of_the_bundle_s_own_weights(tiny, monkeypatch):
    steps = description.read(tiny)["provenance"]["trained_steps"]
    args = SimpleNamespace(bundle=tiny, weights=None)
    assert command.detector_of(args, [], ()) == {}
    args.weights = Path("weights.pt")
    load = {"weights": (None, None, steps + 1)}
    monkeypatch.setattr(command.checkpoint, "load_weights", lambda path: load["weights"])
    with pytest.raises(UserError, match=f"expected weights of {steps} steps"):
        command.detector_of(args, [], ())
    load["weights"] = (None, None, steps)
    monkeypatch.setattr(command, "Searches", lambda config, known: None)
    chosen = command.thresholds.Thresholds(0.4, 0.2, 1.0, 1.0, 1.0)
    monkeypatch.setattr(command.thresholds, "choose", lambda *args: chosen)
    assert command.detector_of(args, [], ()) == {"score_threshold": 0.4, "agree_threshold": 0.2}

"""Requests: which objects are given, in which frame, and that the command line says the same."""

import json
import pickle
import shutil

import numpy as np
import pytest

import mvtop

# A quarter turn about z, and a move.
BASE_FROM_WORLD = np.array([[0.0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])
POLYGON = [[0, 0], [160, 0], [160, 120], [0, 120]]


@pytest.fixture(scope="module")
def predict(estimator, rig, paths, truth):
    def run(**request):
        return estimator.predict(paths, rig, boxes=truth, request=mvtop.Request(**request))

    return run


@pytest.fixture(scope="module")
def sure(tmp_path_factory):
    """The shipped model with grasps, and its example."""
    folder = tmp_path_factory.mktemp("model") / "mvball"
    shutil.copytree(mvtop.Estimator.load("mvball")._path, folder)
    down = [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 60], [0, 0, 0, 1]]
    grasp = {"class": "mvball", "name": "top", "opening": 70, "T_obj_tool": down}
    ball = {"center": [0, 0, -500], "radius": 1}
    document = {"format": "mvtop-grasps", "version": 1, "unit": "mm"}
    document |= {"gripper": [ball], "grasps": [grasp]}
    (folder / "grasps.json").write_text(json.dumps(document))
    return mvtop.Estimator.load(folder), *mvtop.example()


def test_nothing_asked_is_what_was_always_given(predict, estimator, rig, paths, truth):
    plain = estimator.predict(paths, rig, boxes=truth).to_dict()
    asked = predict().to_dict()
    for report in (plain, asked):
        del report["timings_ms"]
    assert plain == asked
    assert plain["objects"] and "left_out" not in plain and "frame" not in plain


@pytest.mark.parametrize("frame", ["world", "base", "cam1"])
def test_poses_are_given_in_the_frame_that_is_asked_for(predict, rig, frame):
    prediction = predict(frame=frame, base_from_world=BASE_FROM_WORLD)
    cam1 = next(camera for camera in rig.cameras if camera.id == "cam1")
    frame_from_world = {
        "world": np.eye(4),
        "base": BASE_FROM_WORLD,
        "cam1": np.linalg.inv(cam1.world_from_cam),
    }[frame]
    assert prediction.frame == frame
    for found in prediction:
        expected = frame_from_world @ found.world_from_obj
        np.testing.assert_allclose(found.frame_from_obj, expected, atol=1e-9)


def test_region_and_polygons_leave_out_what_is_elsewhere(predict):
    (found,) = predict()
    x, y, z = found.world_from_obj[:3, 3]
    around = [[x - 0.2, y - 0.2, z - 0.2], [x + 0.2, y + 0.2, z + 0.2]]
    kept = predict(region=around)
    assert (len(kept), kept.left_out["region"]) == (1, 0)
    beside = np.array(around) + [0.5, 0, 0]
    gone = predict(region=beside)
    assert (len(gone), gone.left_out["region"]) == (0, 1)
    assert len(predict(polygons={"cam0": POLYGON})) == 1
    gone = predict(polygons={"cam0": np.array(POLYGON) + 500})
    assert (len(gone), gone.left_out["polygons"]) == (0, 1)


def test_priors_and_planes_are_gates(predict):
    (found,) = predict()
    pose = found.world_from_obj
    near, far = pose.copy(), pose.copy()
    near[:3, 3] += [0.01, 0, 0]
    far[:3, 3] += [0.3, 0, 0]
    (kept,) = predict(priors=mvtop.Prior("mvball", near, 0.02, 10))
    np.testing.assert_allclose(kept.world_from_obj, pose, atol=1e-9)
    gone = predict(priors=[mvtop.Prior("mvball", far, 0.02, 10)], why=True)
    (miss,) = gone.why
    assert len(gone) == 0 and (miss.class_name, miss.reason) == ("mvball", "prior")
    assert miss.value > miss.threshold == 3
    assert gone.to_dict()["why"][0]["reason"] == "prior"
    # Its own z axis is upright to itself; a plane at its lowest point holds it.
    axis = pose[:3, 2]
    low = (found.world_from_obj[:3, 3] - 0.2 * axis).tolist()
    limits = {"within_m": 0.2, "within_deg": 5}
    assert len(predict(planes=mvtop.Plane(point=low, normal=axis, **limits))) == 1
    tilted = predict(planes=mvtop.Plane(point=low, normal=-axis, **limits), why=True)
    assert (len(tilted), tilted.why[0].reason) == (0, "tilt")
    assert predict().why is None
    with pytest.raises(ValueError, match="sigma_m: expected a standard deviation above 0"):
        mvtop.Request(priors=mvtop.Prior("mvball", pose, 0, 10))
    with pytest.raises(ValueError, match="within_deg"):
        mvtop.Request(planes=mvtop.Plane(point=low, normal=axis, within_m=0.2, within_deg=-1))


def test_arguments_replace_what_the_request_says(estimator, rig, paths, truth):
    request = mvtop.Request(reference="cam1", boxes=truth, refine=False)
    first = estimator.predict(paths, rig, request=request)
    assert first.reference == "cam1"
    assert first[0].boxes.keys() == truth[0]["boxes"].keys()
    assert estimator.predict(paths, rig, request=request, reference="cam2").reference == "cam2"


def test_tracker_answers_requests_as_the_estimator_does(estimator, rig, paths, truth):
    request = mvtop.Request(frame="cam1", classes="mvball")
    tracker = mvtop.Tracker(estimator, rig)
    tracker.update(paths)
    (tracked,) = tracker.predict(boxes=truth, request=request)
    (found,) = estimator.predict(paths, rig, boxes=truth, request=request)
    np.testing.assert_allclose(tracked.frame_from_obj, found.frame_from_obj, atol=1e-9)
    with pytest.raises(ValueError, match="no camera `top`"):
        tracker.predict(request=mvtop.Request(frame="top"))


def test_verdicts_and_grasps_are_given(sure):
    estimator, rig, images = sure
    request = mvtop.Request(min_confidence=0.5, grasps=True, most=1)
    prediction = estimator.predict(images, rig, request=request)
    (found,) = prediction
    assert found.verdict == "accept" and found.confidence >= 0.5
    (grasp,) = found.grasps
    assert (grasp.name, grasp.opening_m, grasp.collides) == ("top", 0.07, False)
    obj_from_tool = np.array([[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0.06], [0, 0, 0, 1]])
    np.testing.assert_allclose(
        grasp.frame_from_tool, found.world_from_obj @ obj_from_tool, atol=1e-9
    )
    doubted = estimator.predict(images, rig, request=mvtop.Request(min_confidence=1.0))
    assert doubted[0].verdict != "accept"
    assert [one.name for one in prediction[[0]][0].grasps] == ["top"]


def test_command_line_answers_the_same_request(sure, cli, tmp_path):
    estimator, rig, images = sure
    request = mvtop.Request(
        frame="base", base_from_world=BASE_FROM_WORLD, grasps=True, min_confidence=0.5, most=1
    )
    report = estimator.predict(images, rig, request=request).to_dict()
    path = tmp_path / "request.json"
    path.write_text(request.to_json())
    rig.save(tmp_path / "rig.json")
    done = cli(
        "infer", "--model", estimator._path, "--rig", tmp_path / "rig.json", "--json",
        "--request", path, *images.values(),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    expected = json.loads(done.stdout)
    for one in (report, expected):
        del one["timings_ms"]
    assert report == expected


def test_requests_are_read_as_they_were_written():
    request = mvtop.Request(
        classes=["mvball"], most=np.int64(2), region=[[0, 0, 0], [1, 1, 1]], frame="base",
        polygons={"cam0": POLYGON}, base_from_world=BASE_FROM_WORLD, min_confidence=0.5,
        grasps=True, reference="cam0", min_views=2, refine=False,
        boxes=[{"class": "mvball", "boxes": {"cam0": [1, 2, 3, 4]}}], why=True,
        priors=[mvtop.Prior("mvball", np.eye(4), 0.01, 10.0)],
        planes=[mvtop.Plane(point=[0, 0, 1], normal=[0, 0, 2], within_m=0.01, within_deg=10)],
    )  # fmt: skip
    assert mvtop.Request.from_json(request.to_json()) == request
    assert pickle.loads(pickle.dumps(request)) == request
    assert json.loads(request.to_json())["T_base_world"] == BASE_FROM_WORLD.tolist()
    assert mvtop.Request().to_json() == "{}"


REFUSED = {
    "most": ({"most": "two"}, "request: expected JSON"),
    "region of four": ({"region": [[0, 0], [1, 1]]}, "region: expected finite numbers of shape"),
    "region not finite": ({"region": [[0, 0, 0], [1, 1, np.nan]]}, "some that are not finite"),
    "prior": ({"priors": [{"class": "mvball"}]}, "priors: expected mvtop.Prior, got dict"),
    "polygon": ({"polygons": {"cam0": [1, 2]}}, "camera `cam0`: expected finite numbers"),
    "base": ({"base_from_world": np.eye(3)}, "base_from_world: expected finite numbers"),
    "confidence not finite": ({"min_confidence": np.inf}, "finite numbers"),
    "no number": ({"most": object()}, "request: expected names and finite numbers"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_no_request_is_refused_at_once(case):
    values, sentence = REFUSED[case]
    with pytest.raises(ValueError) as refusal:
        mvtop.Request(**values)
    assert sentence in str(refusal.value) and "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"classes": ["nut"]}, "no class `nut`"),
        ({"most": 0}, "expected 1 or more"),
        ({"region": [[0, 0, 0], [1, 0, 1]]}, "region: expected a box"),
        ({"polygons": {"top": POLYGON}}, "no camera `top`"),
        ({"frame": "base"}, "T_base_world"),
        ({"base_from_world": np.diag([1, 1, -1, 1])}, "reflection"),
        ({"grasps": True}, "grasps.json"),
    ],
)
def test_what_does_not_fit_rig_or_model_is_refused(predict, values, sentence):
    with pytest.raises(ValueError) as refusal:
        predict(**values)
    assert sentence in str(refusal.value) and "\n" not in str(refusal.value)


def test_only_requests_are_requests(estimator, rig, paths):
    with pytest.raises(ValueError, match=r"request: expected a mvtop.Request, got dict"):
        estimator.predict(paths, rig, request={"most": 1})
    with pytest.raises(ValueError, match="request: expected JSON"):
        mvtop.Request.from_json('{"klasses": []}')

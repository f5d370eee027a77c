"""Predictions from Python: what comes back, and what is refused."""

import copy
import json
import pickle
import threading
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import mvtop


def numbers(prediction):
    """All of a prediction but the time that it took."""
    report = prediction.to_dict()
    del report["timings_ms"]
    return report


@pytest.fixture(scope="module")
def arrays(paths):
    return [cv2.imread(str(path))[..., ::-1] for path in paths]  # a view with negative strides


@pytest.fixture(scope="module")
def prediction(estimator, rig, arrays, truth):
    return estimator.predict(arrays, rig, boxes=truth)


def test_answers_what_the_command_line_answers(prediction, cli, paths):
    sample = paths[0].parent
    done = cli(
        "infer",
        "--model",
        sample.parent,
        "--rig",
        sample / "rig.json",
        "--json",
        *paths,
        "--boxes",
        sample / "truth.json",
    )
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert list(report.pop("timings_ms")) == list(prediction.timings_ms)
    assert report["objects"]
    assert numbers(prediction) == report


def test_arrays_and_paths_and_dicts_are_the_same_images(estimator, rig, paths, arrays, truth):
    ids = [camera.id for camera in rig.cameras]
    given = [
        arrays,
        [np.ascontiguousarray(image) for image in arrays],
        np.stack(arrays),
        paths,
        [str(path) for path in paths],
        dict(zip(ids, [paths[0], arrays[1], paths[2], arrays[3]], strict=True)),
        [paths[n] for n in (2, 0, 3, 1)],  # named after cameras
        dict(reversed(list(zip(ids, arrays, strict=True)))),
    ]
    all_ = [numbers(estimator.predict(images, rig, boxes=truth)) for images in given]
    assert all(report == all_[0] for report in all_)


def test_poses_and_quaternions_agree(estimator, rig, arrays, truth):
    reference = rig.cameras[1]
    assert reference.id != rig.reference
    found = estimator.predict(arrays, rig, boxes=truth, reference=reference.id).objects[0]
    np.testing.assert_allclose(
        reference.world_from_cam @ found.ref_from_obj, found.world_from_obj, atol=1e-9
    )
    for camera in rig.cameras:
        np.testing.assert_allclose(
            camera.world_from_cam @ found.cam_from_obj[camera.id], found.world_from_obj, atol=1e-9
        )
    w, x, y, z = found.quat_wxyz
    assert list(found.quat_xyzw) == [x, y, z, w]
    # Rotation of a quaternion, by its definition: v + 2 q x (q x v + w v).
    v, q = np.array([0.3, -0.5, 0.7]), np.array([x, y, z])
    turned = v + 2 * np.cross(q, np.cross(q, v) + w * v)
    np.testing.assert_allclose(found.ref_from_obj[:3, :3] @ v, turned, atol=1e-9)


def test_boxes_are_those_given(prediction, truth):
    boxes = prediction.objects[0].boxes
    assert set(boxes) == set(truth[0]["boxes"])
    for camera, box in boxes.items():
        np.testing.assert_allclose(box, truth[0]["boxes"][camera], atol=1e-6)
    assert prediction.objects[0].score == 1


def test_some_cameras_are_given_by_their_ids(estimator, rig, arrays, truth):
    found = estimator.predict({rig.cameras[2].id: arrays[2]}, rig, boxes=truth).objects[0]
    assert list(found.cameras) == [rig.cameras[2].id]


def test_bop_lines_have_millimetres_and_rows(prediction, rig):
    first, other = rig.cameras[0].id, rig.cameras[1].id
    text = prediction.to_bop_csv(7, {first: 3, other: 4})
    header, *rows = text.splitlines()
    assert header == "scene_id,im_id,obj_id,score,R,t,time"
    assert len(rows) == 2 * len(prediction.objects)
    found = prediction.objects[0]
    for row, camera, image in [(rows[0], first, 3), (rows[len(rows) // 2], other, 4)]:
        scene_id, im_id, obj_id, score, rotation, translation, time = row.split(",")
        assert (int(scene_id), int(im_id), int(obj_id)) == (7, image, found.class_id)
        assert float(score) == found.score
        pose = found.cam_from_obj[camera]
        assert [float(x) for x in rotation.split()] == list(pose[:3, :3].ravel())
        np.testing.assert_allclose([float(x) for x in translation.split()], 1e3 * pose[:3, 3])
        assert float(time) == pytest.approx(prediction.timings_ms["total"] / 1e3)
    alone = prediction.to_bop_csv(7, 3, header=False)
    assert alone.splitlines() == [row for row in rows if row.startswith("7,3,")]
    with pytest.raises(ValueError, match="camera `none`"):
        prediction.to_bop_csv(7, {"none": 3})


def test_pickled_predictions_have_numbers_but_no_images(prediction):
    again = pickle.loads(pickle.dumps(prediction))
    assert numbers(again) == numbers(prediction)
    assert len(pickle.dumps(prediction)) < 50_000
    with pytest.raises(ValueError, match="pickled"):
        again.overlay()


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy])
def test_copies_of_predictions_keep_their_images(prediction, copied):
    again = copied(prediction)
    assert numbers(again) == numbers(prediction)
    for camera, picture in prediction.overlay().items():
        assert np.array_equal(again.overlay()[camera], picture)
    shared = again.objects[0] is prediction.objects[0]
    assert shared == (copied is copy.copy)


def test_masked_images_are_refused(estimator, rig, arrays):
    masked = np.ma.masked_array(arrays[0], mask=True)
    with pytest.raises(ValueError, match="expected an RGB array .* got a masked array of uint8"):
        estimator.predict({rig.cameras[0].id: masked}, rig)


def test_pickled_estimators_and_rigs_predict_the_same(estimator, rig, arrays, prediction, truth):
    estimator, rig = pickle.loads(pickle.dumps((estimator, rig)))
    again = estimator.predict(arrays, rig, boxes=truth)
    np.testing.assert_allclose(
        again.objects[0].ref_from_obj, prediction.objects[0].ref_from_obj, atol=1e-9
    )


def test_settings_of_the_inference_are_kept_by_pickles(estimator, rig, arrays):
    strict = {"association.box_tolerance": 0.0}
    strict = mvtop.Estimator.load(estimator._path, inference=strict)
    again = pickle.loads(pickle.dumps(strict))
    expected = numbers(strict.predict(arrays, rig))
    assert numbers(again.predict(arrays, rig)) == expected
    assert numbers(estimator.predict(arrays, rig)) != expected


@pytest.mark.parametrize(
    ("setting", "sentence"),
    [
        ({"search.setled": 0.8}, "`search.setled`: expected the name of a setting"),
        ({"search.settled": "x"}, "`search.settled`"),
        ({"search.settled": 3}, "expected 0 to 1, got 3"),
    ],
)
def test_wrong_settings_are_value_errors(estimator, setting, sentence):
    with pytest.raises(ValueError, match=sentence):
        mvtop.Estimator.load(estimator._path, inference=setting)


def test_edges_are_not_drawn_of_classes_without_a_mesh(prediction):
    with pytest.raises(ValueError, match="edges: expected a model bundle with a mesh"):
        prediction.overlay(edges=True)


def test_overlay_is_the_command_lines(prediction, cli, paths, tmp_path):
    sample = paths[0].parent
    done = cli(
        "infer",
        "--model",
        sample.parent,
        "--rig",
        sample / "rig.json",
        *paths,
        "--boxes",
        sample / "truth.json",
        "--overlay",
        tmp_path,
    )
    assert done.returncode == 0, done.stderr
    pictures = prediction.overlay()
    assert len(pictures) == len(paths)
    for camera, picture in pictures.items():
        expected = cv2.imread(str(tmp_path / f"{camera}.png"))[..., ::-1]
        np.testing.assert_array_equal(picture, expected)


def test_objects_say_what_they_are(estimator, prediction):
    (known,) = estimator.classes
    assert repr(known).startswith("ObjectClass('mvball', id 1, ")
    assert repr(prediction.objects[0]).startswith("ObjectPose('mvball', score 1.00, expected off")
    assert repr(prediction).startswith("Prediction(mvball 1.00; reference cam0; ")


def test_only_load_makes_an_estimator(estimator):
    with pytest.raises(TypeError, match=r"expected Estimator.load\(path\)"):
        mvtop.Estimator(estimator._path)


def test_classes_have_their_points(estimator):
    (known,) = estimator.classes
    assert (known.name, known.id) == ("mvball", 1)
    spread = np.linalg.norm(known.points[:, None] - known.points[None], axis=-1).max()
    assert 0.9 * known.diameter_m < spread < 1.01 * known.diameter_m


REFUSED = {
    "no list": (lambda a: {"images": a[0].tobytes()}, "images: expected a list"),
    "a path": (lambda a: {"images": "cam0.png"}, "images: expected a list"),
    "too few": (lambda a: {"images": a[:1]}, "images: expected 4, one for each camera"),
    "only some named": (
        lambda a: {"images": ["cam1.png", "cam0.png", "front.png", "cam3.png"]},
        "(cam0, cam1, cam2, cam3), as `cam1.png` is, got `front.png`; give a dict by camera id",
    ),
    "named and array": (
        lambda a: {"images": ["cam1.png", *a[1:]]},
        "as `cam1.png` is, got an array",
    ),
    "one name twice": (
        lambda a: {"images": ["a/cam1.png", "cam0.png", "cam2.png", "b/cam1.png"]},
        "after camera `cam1`, got `a/cam1.png` and `b/cam1.png`",
    ),
    "unknown camera": (lambda a: {"images": {"top": a[0]}}, "no camera `top` in the rig"),
    "none": (lambda a: {"images": {}}, "no image given"),
    "floats": (
        lambda a: {"images": [x / 255 for x in a]},
        "`cam0`: expected an RGB array of",
    ),
    "grey": (lambda a: {"images": [x[..., 0] for x in a]}, "shape (H, W, 3), got uint8 and"),
    "four channels": (
        lambda a: {"images": [np.dstack([x, x[..., 0]]) for x in a]},
        "got uint8 and",
    ),
    "another size": (lambda a: {"images": [x[:-2] for x in a]}, "expected an image of"),
    "no image": (lambda a: {"images": [None] * 4}, "or a path, got"),
    "unknown reference": (lambda a: {"reference": "top"}, "reference: no camera `top`"),
    "boxes of no class": (lambda a: {"boxes": [{"boxes": {}}]}, "boxes: expected"),
    "short box": (
        lambda a: {"boxes": [{"class": "mvball", "boxes": {"cam0": [1, 2, 3]}}]},
        "boxes: expected",
    ),
    "too many views": (lambda a: {"min_views": 5}, "fewest views of an object: expected at most 4"),
    "path of a rig": (lambda a: {"rig": "rig.json"}, "rig: expected a mvtop.Rig, got str"),
    "unknown class": (lambda a: {"boxes": [{"class": "cup", "boxes": {}}]}, "cup"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_mistakes_are_value_errors_of_one_sentence(case, estimator, rig, arrays):
    mistake, sentence = REFUSED[case]
    with pytest.raises(ValueError) as refusal:
        estimator.predict(**{"images": arrays, "rig": rig, **mistake(arrays)})
    assert sentence in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_files_that_cannot_be_read_are_os_errors(estimator, rig, tmp_path):
    with pytest.raises(FileNotFoundError, match="cannot read"):
        estimator.predict({"cam0": tmp_path / "none.png"}, rig)
    with pytest.raises(FileNotFoundError, match="cannot read"):
        mvtop.Rig.load(tmp_path / "none.json")
    with pytest.raises(FileNotFoundError, match="model.json: cannot be read"):
        mvtop.Estimator.load(tmp_path / "none")
    with pytest.raises(OSError):
        estimator.predict({"cam0": estimator}, rig, boxes=tmp_path / "none.json")


def test_a_broken_bundle_is_an_mvtop_error(tmp_path):
    (tmp_path / "model.json").write_text("{}")
    with pytest.raises(mvtop.Error, match="model.json"):
        mvtop.Estimator.load(tmp_path)


def test_unknown_providers_and_missing_libraries_are_named(estimator, tmp_path):
    with pytest.raises(ValueError, match="`tpu`: expected one of cpu"):
        mvtop.Estimator.load(estimator._path, provider="tpu")
    with pytest.raises(mvtop.Error, match="cuda"):
        mvtop.Estimator.load(estimator._path, provider="cuda")
    with pytest.raises(mvtop.Error, match="already loaded"):
        mvtop.Estimator.load(estimator._path, ort_lib=tmp_path / "other.so")


def test_array_that_is_larger_than_the_memory_is_refused_before_it_is_copied(
    estimator, rig, arrays
):
    huge = np.broadcast_to(np.zeros((1, 1, 3), np.uint8), (10**6, 10**6, 3))
    with pytest.raises(ValueError, match="expected an image of 160x120 px .* got 1000000x1000000"):
        estimator.predict([huge, *arrays[1:]], rig)


def test_covered_camera_is_warned_of(estimator, rig, arrays):
    def covered(images):
        warnings = estimator.predict(images, rig).warnings
        return [warning for warning in warnings if warning.code == "one_color"]

    assert covered(arrays) == []
    (warning,) = covered([np.zeros_like(arrays[0]), *arrays[1:]])
    assert (warning.camera, warning.object) == (rig.cameras[0].id, None)
    assert "is of one color" in warning.message


def test_wrong_calibration_is_warned_of(estimator, rig, arrays):
    fit = estimator.predict(arrays, rig).rig_consistency
    assert isinstance(fit, mvtop.RigConsistency)
    assert fit.px < 5
    half_turn = np.diag([1.0, -1, -1, 1])
    cameras = [
        mvtop.Camera(c.K, c.size, world_from_cam=np.array(c.world_from_cam) @ half_turn, id=c.id)
        for c in rig.cameras
    ]
    prediction = estimator.predict(arrays, mvtop.Rig(cameras))  # OpenGL's axes
    (warning,) = prediction.warnings
    assert (warning.code, warning.object) == ("nothing_matches", None)
    assert "do not show the same scene" in warning.message
    assert prediction.rig_consistency.contradiction > 2


def assert_same(warm, cold):
    """To rounding: a network may compute a picture otherwise beside others."""
    assert len(warm.objects) == len(cold.objects) == 1
    for key in ("ref_from_obj", "world_from_obj"):
        a, b = (getattr(prediction.objects[0], key) for prediction in (warm, cold))
        np.testing.assert_allclose(a, b, atol=1e-6)
    np.testing.assert_equal(warm.objects[0].boxes, cold.objects[0].boxes)


def test_a_tracker_keeps_the_latest_image_of_each_camera(estimator, rig, arrays, truth):
    ids = [camera.id for camera in rig.cameras]
    tracker = mvtop.Tracker(estimator, rig)
    with pytest.raises(ValueError, match="image"):
        tracker.predict()
    tracker.update(arrays)
    assert_same(tracker.predict(boxes=truth), estimator.predict(arrays, rig, boxes=truth))
    images = dict(zip(ids, arrays, strict=True))
    images[ids[1]] = np.ascontiguousarray(arrays[1][:, ::-1])
    tracker.update({ids[1]: images[ids[1]]})
    warm = tracker.predict(boxes=truth)
    assert_same(warm, estimator.predict(images, rig, boxes=truth))
    assert warm.overlay()[ids[1]].shape == images[ids[1]].shape
    with pytest.raises(ValueError, match=ids[0]):
        tracker.update({ids[0]: arrays[0][:8, :8]})
    with pytest.raises(ValueError, match="expected one of"):
        tracker.remove("nowhere")
    tracker.remove(ids[0])
    del images[ids[0]]
    assert_same(tracker.predict(boxes=truth), estimator.predict(images, rig, boxes=truth))


def test_a_tracker_s_objects_keep_their_numbers(estimator, rig, arrays, truth):
    tracker = mvtop.Tracker(estimator, rig, patience=0)
    tracker.update(arrays)
    first = tracker.predict(boxes=truth)
    assert [found.track_id for found in first.objects] == [1]
    assert first.to_dict()["objects"][0]["track_id"] == 1
    assert [found.track_id for found in tracker.predict(boxes=truth).objects] == [1]
    single = estimator.predict(arrays, rig, boxes=truth)
    assert single.objects[0].track_id is None
    assert "track_id" not in single.to_dict()["objects"][0]
    with pytest.raises(ValueError, match="max_motion_m: expected metres"):
        mvtop.Tracker(estimator, rig, max_motion_m=-1)


def test_objects_of_single_predictions_are_followed_by_tracks(estimator, rig, arrays, truth):
    tracks = mvtop.Tracks(patience=0)
    groups = estimator.predict([arrays, arrays], rig, boxes=[truth, truth], tracks=tracks)
    assert [found.track_id for group in groups for found in group] == [1, 1]
    # What is not wanted is followed all the same.
    nowhere = mvtop.Request(region=[[50, 50, 50], [51, 51, 51]])
    assert not len(estimator.predict(arrays, rig, boxes=truth, request=nowhere, tracks=tracks))
    (again,) = estimator.predict(arrays, rig, boxes=truth, tracks=tracks)
    assert again.track_id == 1
    still = mvtop.Tracks(max_motion_m=0)
    for number, images in enumerate((arrays, [np.zeros_like(image) for image in arrays]), 1):
        (found,) = estimator.predict(images, rig, boxes=truth, tracks=still)
        assert found.track_id == number
    with pytest.raises(ValueError, match="max_motion_m: expected metres"):
        mvtop.Tracks(max_motion_m=float("inf"))


def test_a_tracker_s_prediction_is_drawn_onto_the_images_that_it_was_made_from(
    estimator, rig, arrays, truth
):
    tracker = mvtop.Tracker(estimator, rig)
    tracker.update(arrays)
    native = tracker._native
    black = [np.zeros_like(image) for image in arrays]
    update = threading.Thread(target=tracker.update, args=(black,))

    def predict(*options):
        prediction = native.predict(*options)
        update.start()
        update.join(timeout=0.5)  # it has to wait
        return prediction

    tracker._native = SimpleNamespace(predict=predict, update=native.update)
    prediction = tracker.predict(boxes=truth)
    update.join()
    assert all(np.median(picture) > 0 for picture in prediction.overlay().values())


def test_interrupts_are_none_of_a_value(estimator, rig):
    class Interrupted:
        def __array__(self, *_, **__):
            raise KeyboardInterrupt

        def __fspath__(self):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        mvtop.rotation_from_6d(Interrupted())
    with pytest.raises(KeyboardInterrupt):
        estimator.predict({rig.cameras[0].id: Interrupted()}, rig)


def test_sets_of_images_and_texts_as_boxes_are_refused(estimator, rig, paths):
    with pytest.raises(ValueError, match="images: expected a list of arrays or paths.*got set"):
        estimator.predict(set(paths), rig)
    no_boxes = [
        "1234",
        b"1234",
        bytearray(4),
        memoryview(b"1234"),
        {1, 2, 3, 4},
        ["1", "2", "3", "4"],
    ]
    for no_box in [*no_boxes, dict.fromkeys([1, 2, 3, 4])]:
        boxes = [{"class": "mvball", "boxes": {rig.cameras[0].id: no_box}}]
        with pytest.raises(ValueError, match="boxes: expected .* is no box"):
            estimator.predict(paths, rig, boxes=boxes)

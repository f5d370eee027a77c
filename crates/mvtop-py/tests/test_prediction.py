"""A prediction as a container: what it holds, how it is cut down, what it becomes."""

import json
import pickle
import sys
import warnings
from dataclasses import replace

import numpy as np
import pytest

import mvtop


@pytest.fixture(scope="module")
def three(estimator, rig, paths, truth):
    """Three objects, of given boxes, with confidences."""
    prediction = estimator.predict(paths, rig, boxes=truth * 3)
    objects = [
        replace(found, confidence=confidence, score=confidence)
        for found, confidence in zip(prediction.objects, (0.2, 0.9, 0.5), strict=True)
    ]
    doubts = [
        mvtop.PredictionWarning("lines_miss", None, 1, "of the second"),
        mvtop.PredictionWarning("one_color", "cam0", None, "of a camera"),
        mvtop.PredictionWarning("sizes_disagree", None, 2, "of the third"),
    ]
    return replace(prediction, objects=objects, warnings=doubts)


def test_it_is_a_container_of_objects(three):
    assert len(three) == 3
    assert [found.score for found in three] == [0.2, 0.9, 0.5]
    assert three[0] is three.objects[0] and three[-1] is three[np.int64(2)]
    with pytest.raises(IndexError, match="expected an index of 3 objects, got 3"):
        three[3]


@pytest.mark.parametrize(
    ("which", "scores"),
    [
        (slice(1, None), [0.9, 0.5]),
        (slice(None, None, -1), [0.5, 0.9, 0.2]),
        ([True, False, True], [0.2, 0.5]),
        (np.array([False, False, True]), [0.5]),
        ([2, -3], [0.5, 0.2]),
        ([], []),
    ],
)
def test_slices_masks_and_indices_give_predictions(three, which, scores):
    some = three[which]
    assert isinstance(some, mvtop.Prediction)
    assert [found.score for found in some] == scores
    assert some.rig is three.rig and some.reference == three.reference


def test_warnings_go_with_their_objects(three):
    some = three[[2, 0]]
    assert [(w.message, w.object) for w in some.warnings] == [
        ("of a camera", None),
        ("of the third", 0),
    ]


@pytest.mark.parametrize(
    ("which", "error", "sentence"),
    [
        ([True, False], IndexError, "expected a mask of 3, one each, got 2"),
        ([0, 3], IndexError, "expected indices of 3 objects, got 3"),
        ("mvball", TypeError, "expected an index, a slice, a boolean mask .* got str"),
        ([0.5], TypeError, "expected an index, a slice"),
    ],
)
def test_what_is_no_index_is_refused(three, which, error, sentence):
    with pytest.raises(error, match=sentence):
        three[which]


def test_a_part_is_drawn_alone(three):
    whole, part, none = three.overlay(), three[:1].overlay(), three[:0].overlay()
    images = {camera: np.array(picture) for camera, picture in none.items()}
    for camera in whole:
        assert (part[camera] != images[camera]).any()
        assert part[camera].shape == whole[camera].shape


def test_objects_are_chosen_by_confidence_and_class(three):
    assert list(three.filter(min_confidence=0.5).confidence) == [0.9, 0.5]
    assert len(three.filter(class_name="mvball")) == 3
    assert len(three.filter(class_name=["mvball"], min_confidence=0.95)) == 0
    with pytest.raises(ValueError, match="class_name: no class `cup` in the model, .* mvball"):
        three.filter(class_name="cup")
    with pytest.raises(ValueError, match="min_confidence: expected 0 to 1, got 90"):
        three.filter(min_confidence=90)
    unknown = replace(three, objects=[replace(found, confidence=None) for found in three])
    with pytest.raises(ValueError, match="min_confidence: .* the model is not calibrated"):
        unknown.filter(min_confidence=0.5)
    assert np.isnan(unknown.confidence).all()


def test_columns_are_arrays(three):
    assert three.poses.shape == (3, 4, 4)
    for pose, found in zip(three.poses, three, strict=True):
        assert np.array_equal(pose, found.ref_from_obj)
    assert three.class_id.tolist() == [1, 1, 1]
    assert (three.class_name == "mvball").all()
    assert three.score.tolist() == three.confidence.tolist() == [0.2, 0.9, 0.5]
    none = three[[]]
    assert none.poses.shape == (0, 4, 4)
    for column in (none.class_id, none.class_name, none.score, none.confidence):
        assert column.shape == (0,)


def test_json_is_the_dict_and_holds_what_the_objects_hold(three):
    report = three.to_dict()
    assert json.loads(three.to_json()) == report
    assert [found["confidence"] for found in report["objects"]] == [0.2, 0.9, 0.5]
    assert report["objects"][1]["T_ref_obj"] == three[1].ref_from_obj.tolist()
    assert len(three[:1].to_dict()["objects"]) == 1
    report["objects"][0]["sigma"]["rot_deg"] = -1
    assert three.to_dict()["objects"][0]["sigma"]["rot_deg"] > 0
    again = pickle.loads(pickle.dumps(three))
    assert again.to_dict() == three.to_dict()
    assert [found.score for found in again[1:]] == [0.9, 0.5]


def test_a_table_has_a_row_for_each_object(three):
    pytest.importorskip("pandas")
    table = three.to_pandas()
    assert list(table["confidence"]) == [0.2, 0.9, 0.5]
    position = table[["x_m", "y_m", "z_m"]].to_numpy()
    assert np.array_equal(position, three.poses[:, :3, 3])
    assert np.array_equal(table[["qw", "qx", "qy", "qz"]].to_numpy()[0], three[0].quat_wxyz)
    assert len(three[[]].to_pandas()) == 0


def test_a_table_asks_for_pandas(three, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(mvtop.Error, match="needs the package pandas; `pip install pandas`"):
        three.to_pandas()


def test_warnings_are_python_s_too(estimator, rig, paths):
    dark = {camera.id: path for camera, path in zip(rig.cameras, paths, strict=True)}
    width, height = rig.cameras[0].size
    dark[rig.cameras[0].id] = np.zeros((height, width, 3), np.uint8)
    with pytest.warns(mvtop.MvtopWarning, match="is of one color") as caught:
        prediction = estimator.predict(dark, rig)
    assert {str(warning.message) for warning in caught} == {
        warning.message for warning in prediction.warnings
    }
    assert all(warning.filename == __file__ for warning in caught)
    with warnings.catch_warnings():
        warnings.simplefilter("error", mvtop.MvtopWarning)
        with pytest.raises(mvtop.MvtopWarning, match="is of one color"):
            estimator.predict(dark, rig)


def test_no_public_name_hides_one_of_python_s():
    import builtins

    taken = {*dir(builtins), *sys.stdlib_module_names}
    public = {name for name in mvtop.__all__ if not name.startswith("__")}
    assert not public & taken

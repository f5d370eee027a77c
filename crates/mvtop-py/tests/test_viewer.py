"""What goes to the Rerun viewer."""

import numpy as np
import pytest
import rerun as rr

import mvtop
from mvtop._viewer import line_of_sight


def recorded(shown, path, tmp_path) -> bytes:
    """The recording of a rig or a prediction."""
    recording = rr.RecordingStream("mvtop_test")
    file = tmp_path / "shown.rrd"
    recording.save(file)
    shown.to_rerun(recording, path=path)
    recording.flush()
    recording.disconnect()
    return file.read_bytes()


@pytest.mark.parametrize("count", [1, 3])
def test_recording_of_a_rig_has_cameras_and_distances(count, tmp_path, monkeypatch):
    logged, log = {}, rr.log

    def keep(entity, component, **more):
        logged[entity] = component
        log(entity, component, **more)

    monkeypatch.setattr(rr, "log", keep)
    poses = np.stack([np.eye(4)] * count)
    poses[:, 0, 3] = 0.125 * np.arange(count) ** 2
    k = [[500.0, 0, 320], [0, 510, 240], [0, 0, 1]]
    rig = mvtop.Rig.from_arrays(k, poses, (640, 480))
    bytes_ = recorded(rig, "cell", tmp_path)
    for camera in rig.cameras:
        for entity in ("image", "axes"):
            assert f"/cell/cameras/{camera.id}/{entity}".encode() in bytes_, (camera.id, entity)
    assert b"/cell/distances" in bytes_
    labels = logged["cell/distances"].labels.as_arrow_array().to_pylist()
    assert labels == (["0.125 m", "0.500 m", "0.375 m"] if count == 3 else [])


def test_recording_has_cameras_images_sights_and_objects(estimator, rig, paths, truth, tmp_path):
    prediction = estimator.predict(paths, rig, boxes=truth)
    bytes_ = recorded(prediction, "scene", tmp_path)
    for entity in [f"/scene/cameras/{camera.id}/image/rgb" for camera in rig.cameras] + [
        "/scene/objects/0_mvball/points",
        "/scene/objects/0_mvball/axes",
        "/scene/sights/0_mvball",
    ]:
        assert entity.encode() in bytes_, entity


def test_lines_of_sight_end_beside_the_object(estimator, rig, paths, truth):
    prediction = estimator.predict(paths, rig, boxes=truth)
    found = prediction.objects[0]
    for camera in rig.cameras:
        line = line_of_sight(camera, found)
        if camera.id not in found.boxes:
            assert line is None
            continue
        np.testing.assert_allclose(line[0], camera.world_from_cam[:3, 3], atol=1e-12)
        # Its end is imaged at the middle of the box.
        end = np.linalg.inv(camera.world_from_cam) @ [*line[1], 1]
        x0, y0, x1, y1 = found.boxes[camera.id]
        np.testing.assert_allclose(
            camera.project(end[:3]), [(x0 + x1) / 2, (y0 + y1) / 2], atol=1e-6
        )

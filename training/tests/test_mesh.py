"""Meshes of bundles: the object in few triangles, listed with a checksum."""

import hashlib
import json

import numpy as np
import pytest
import trimesh

from mvtop_train.data import mvball, objects
from mvtop_train.errors import UserError
from mvtop_train.export import mesh


def test_the_ball_is_where_its_points_are():
    ball = mesh.ball()
    assert len(ball.faces) <= mesh.TRIANGLES
    points, _ = mvball.surface_points(500)
    _, distance, _ = trimesh.proximity.closest_point_naive(ball, points)
    assert distance.max() < 0.0003  # metres
    on_green = np.abs(ball.vertices[:, 0] - mvball.EXTENT) < 0.0002
    assert (ball.visual.vertex_colors[on_green, :3] == [13, 140, 26]).all() and on_green.any()


def test_meshes_are_added_to_a_bundle_and_nothing_else_changes(tmp_path):
    before = {"classes": [{"id": 1, "name": "mvball"}], "files": {"decoder.onnx": {"bytes": 1}}}
    (tmp_path / "model.json").write_text(json.dumps(before))
    mesh.add(tmp_path, {"mvball": mesh.ball()})
    after = json.loads((tmp_path / "model.json").read_text())
    content = (tmp_path / "mvball.mesh.ply").read_bytes()
    entry = {"sha256": hashlib.sha256(content).hexdigest(), "bytes": len(content)}
    before["classes"][0]["mesh"] = "mvball.mesh.ply"
    before["files"]["mvball.mesh.ply"] = entry
    assert after == before
    with pytest.raises(UserError, match="a bundle of 'box'"):
        mesh.add(tmp_path, {"box": mesh.ball()})


def test_small_meshes_stay_and_large_ones_are_decimated_to_the_bound():
    box = trimesh.creation.box((0.1, 0.2, 0.3))
    box.visual.face_colors = [200, 10, 30, 255]
    small = mesh.decimated(box)
    assert np.array_equal(small.faces, box.faces)
    assert (small.visual.vertex_colors[:, :3] == [200, 10, 30]).all()

    pytest.importorskip("fast_simplification")
    ball = objects.ball_mesh()
    coarse = mesh.decimated(ball)
    assert len(ball.faces) > 10 * mesh.TRIANGLES and len(coarse.faces) <= mesh.TRIANGLES
    assert np.abs(coarse.bounds - ball.bounds).max() < 0.001
    top = coarse.vertices[:, 0].argmax()
    red, green, blue = coarse.visual.vertex_colors[top, :3]
    assert green > 2 * red and green > 2 * blue

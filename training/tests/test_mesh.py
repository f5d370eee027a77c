"""Meshes of bundles: the object in few triangles, listed with a checksum."""

import hashlib
import json

import numpy as np
import pytest
import trimesh

from mvtop_train.data import mvball, objects, surface
from mvtop_train.errors import UserError
from mvtop_train.export import mesh


def test_the_ball_is_where_its_points_are():
    ball = mesh.ball()
    assert len(ball.faces) <= surface.TRIANGLES
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
    assert len(ball.faces) > 10 * surface.TRIANGLES and len(coarse.faces) <= surface.TRIANGLES
    assert np.abs(coarse.bounds - ball.bounds).max() < 0.001
    top = coarse.vertices[:, 0].argmax()
    red, green, blue = coarse.visual.vertex_colors[top, :3]
    assert green > 2 * red and green > 2 * blue


def test_borders_between_few_colors_stay_sharp():
    pytest.importorskip("fast_simplification")
    coarse = mesh.decimated(objects.ball_mesh())
    corners = coarse.visual.vertex_colors[:, :3].reshape(-1, 3, 3).astype(int)
    assert (corners == corners[:, :1]).all()
    meant = [np.round(np.array(color) * 255) for color in mvball.COLORS.values()]
    off = np.min([abs(corners[:, 0] - color).max(1) for color in meant], axis=0)
    assert off.max() <= 1
    # On the knob and off it, but for a triangle's width next to the border.
    towards = coarse.triangles_center / np.linalg.norm(coarse.triangles_center, axis=1)[:, None]
    green = abs(corners[:, 0] - meant[list(mvball.COLORS).index("green")]).max(1) <= 1
    angle = np.degrees(np.arccos(towards[:, 0]))
    border = angle[green].max()
    assert not green[angle > border + 6].any() and green[angle < border - 6].all()


def test_a_print_is_no_few_colors():
    print_ = np.random.default_rng(1).integers(0, 256, (500, 3))
    assert mesh.few_colors(print_.astype(float)) is None
    assert mesh.few_colors(np.full((500, 3), 90.0)) is None  # nor is one color
    colors, label = mesh.few_colors(np.array([[200.0, 10, 10], [30, 30, 30], [210, 20, 10]]))
    assert label.tolist() == [0, 1, 0] and colors.tolist() == [[205, 15, 10], [30, 30, 30]]


def test_the_ball_of_a_data_set_is_made_of_spheres(tmp_path):
    objects.write(tmp_path, [(objects.ball(), objects.ball_mesh())])
    found = mesh.meshes_of(tmp_path, objects.read_all(tmp_path))
    assert list(found) == ["mvball"]
    np.testing.assert_array_equal(found["mvball"].vertices, mesh.ball().vertices)

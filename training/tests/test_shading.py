"""Light from surroundings: geometry from depth, and what surfaces make of known light."""

import numpy as np
import pytest

from mvtop_train.synthesis import shading

K = np.array([[100.0, 0, 31.5], [0, 100, 23.5], [0, 0, 1]])
SIZE = 48, 64
# The camera looks along the world's x axis, the right way up.
FORWARD = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
ONE = np.zeros(SIZE, int)


def rays():
    v, u = np.mgrid[: SIZE[0], : SIZE[1]]
    return np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(K).T


def depth_of_plane(normal, distance):
    """Of the plane n x = -distance, in the camera's axes."""
    return -distance / (rays() @ normal)


def even(monkeypatch, floor=1.0):
    """Surroundings that are as bright everywhere above."""
    monkeypatch.setattr(shading, "LAMPS", 0)
    monkeypatch.setattr(shading, "EXPOSURE", (0.5, 0))
    picture = np.full((20, 40, 3), 128, np.uint8)
    return shading.Surroundings(np.random.default_rng(0), picture, np.full(3, floor))


@pytest.mark.parametrize("normal", [(0, 0, -1), (0.6, 0, -0.8), (0, -0.6, -0.8), (0.3, 0.5, -0.8)])
def test_a_plane_has_its_normal_and_hides_nothing_of_itself(normal):
    normal = np.array(normal) / np.linalg.norm(normal)
    depth = depth_of_plane(normal, 0.7)
    found = shading.normals_of(rays() * depth[..., None], ONE)
    assert np.allclose(found, normal, atol=1e-6)
    assert shading.occlusion(depth, 100, 0.05).max() < 1e-3


def test_normals_of_two_things_do_not_mix():
    left, right = np.array([0.6, 0, -0.8]), np.array([-0.6, 0, -0.8])
    ids = (np.arange(SIZE[1]) >= 30) * np.ones(SIZE, int)
    depth = np.where(ids == 0, depth_of_plane(left, 0.7), depth_of_plane(right, 0.9))
    found = shading.normals_of(rays() * depth[..., None], ids)
    assert np.allclose(found, np.where(ids[..., None] == 0, left, right), atol=1e-6)


def test_the_ground_of_a_hole_is_darker_than_what_is_around_it():
    depth = np.full(SIZE, 1.0)
    depth[18:30, 26:38] = 1.05
    taken = shading.occlusion(depth, 100, 0.05)
    assert taken[20:28, 28:36].min() > 0.4
    assert taken[:8].max() < 0.01 and taken[16, 30] < 0.01


def test_white_paper_in_even_light_is_as_bright_as_the_light(monkeypatch):
    around = even(monkeypatch)
    normals = np.random.default_rng(1).normal(size=(10, 10, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    assert np.allclose(around.diffuse(normals), 0.5, atol=0.01)
    for roughness in (0.0, 0.5, 1.0):
        seen = around.seen(normals, np.full((10, 10), roughness))
        assert np.allclose(seen, 0.5, atol=0.01)


def test_metal_mirrors_and_paint_does_not(monkeypatch):
    # The sky is bright, the floor black: a wall that leans back shows the sky, one that leans
    # forward the floor, if it is a mirror.
    around = even(monkeypatch, floor=0.0)
    iron = shading.Material(np.array(shading.METALS["iron"]), 0.05)
    paint = shading.Material(None, 1.0)
    shown = {}
    for name, tilt in (("back", -0.5), ("forward", 0.5)):
        normal = np.array([0, np.sin(tilt), -np.cos(tilt)])
        depth = depth_of_plane(normal, 0.7)
        for material in (iron, paint):
            light = shading.Light(around, [material], 0.05, 0.5)
            albedo = np.full((*SIZE, 3), 200, np.uint8)
            picture = shading.lit(albedo, ONE, depth, K, FORWARD, light)
            shown[name, material is iron] = picture[20:28, 28:36].mean()
    # By hand: 255 (0.5 (200 / 255)^2.2)^(1 / 2.2) = 146.
    assert shown["back", True] == pytest.approx(146, abs=5)
    assert shown["forward", True] < 10
    assert shown["forward", False] > 60
    assert shown["back", False] > shown["forward", False] + 20


def test_where_nothing_stands_surroundings_are_seen(monkeypatch):
    around = even(monkeypatch, floor=0.0)
    light = shading.Light(around, [shading.Material(None, 1.0)], 0.05, 0.5)
    nothing = np.full(SIZE, -1)
    black = np.zeros((*SIZE, 3), np.uint8)
    picture = shading.lit(black, nothing, np.full(SIZE, 5.0), K, FORWARD, light)
    assert picture[:20].min() > 150 and picture[28:].max() < 10


def test_light_is_drawn_from_its_numbers_alone():
    picture = np.random.default_rng(2).integers(0, 256, (40, 60, 3)).astype(np.uint8)
    one, same, other = (
        shading.Surroundings(np.random.default_rng(seed), picture, np.full(3, 0.3))
        for seed in (3, 3, 4)
    )
    up = np.zeros((1, 1, 3)) + [0, 0, 1]
    assert np.array_equal(one.diffuse(up), same.diffuse(up))
    assert not np.allclose(one.diffuse(up), other.diffuse(up), rtol=0.01)

"""Renderers of several sizes and distances show one scene alike."""

import mujoco
import numpy as np
import pytest
import trimesh

from mvtop_train.data import objects, rig, surface
from mvtop_train.synthesis import parts
from mvtop_train.synthesis.gl import open_gl
from mvtop_train.synthesis.render import FAR, NEAR, Renderer

SCENE = """<mujoco>
  <visual><global offwidth="200" offheight="160"/></visual>
  <worldbody>
    <geom name="floor" type="plane" size="4 4 0.1"/>
    <geom name="box" type="box" size="0.1 0.1 0.1" pos="0 0 0.1"/>
  </worldbody>
</mujoco>"""


@pytest.fixture(scope="module")
def gl():
    return open_gl()


@pytest.fixture(scope="module")
def scene():
    model = mujoco.MjModel.from_xml_string(SCENE)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def look(renderer, data, height=1.0, across=0.0):
    """Which pixels show the box, and the depth, seen from straight above."""
    middle = renderer.width / 2 - 0.5, renderer.height / 2 - 0.5
    k = np.array([[200.0, 0, middle[0]], [0, 200, middle[1]], [0, 0, 1]])
    cam_from_world = np.diag([1.0, -1, -1, 1])
    cam_from_world[:3, 3] = [-across, 0, height]
    renderer.aim(data, k, cam_from_world)
    ids, depth = renderer.geom_ids_depth()
    return ids == renderer.model.geom("box").id, depth


def test_renderers_of_two_sizes_take_turns(gl, scene):
    model, data = scene
    alone = Renderer(model, 160, 120, gl)
    mask, depth = look(alone, data, across=0.15)
    alone.close()
    small, large = Renderer(model, 160, 120, gl), Renderer(model, 200, 160, gl)
    look(small, data)
    look(large, data)
    again, depth_again = look(small, data, across=0.15)
    small.close(), large.close()
    assert mask.any() and np.array_equal(again, mask) and np.array_equal(depth_again, depth)


def test_triangles_have_two_sides(gl):
    """As a scan without its bottom shows its inside from below."""
    box = trimesh.creation.box([0.1] * 3)
    lidless = trimesh.Trimesh(box.vertices, box.faces[box.face_normals[:, 2] < 0.5])
    kit = parts.Kit([parts.Part(lidless, objects.from_mesh(lidless, 1, "box"))])
    body = kit.parts[0].body(np.random.default_rng(0), "box", np.zeros(3))
    visual = '<visual><global offwidth="160" offheight="120"/></visual>'
    xml = f"<mujoco>{visual}{kit.parts[0].asset()}{body}</mujoco>"
    model = mujoco.MjModel.from_xml_string(xml, kit.files)
    data = mujoco.MjData(model)
    data.qpos[3:] = [1, 0, 0, 0]
    mujoco.mj_forward(model, data)
    renderer = Renderer(model, 160, 120, gl, kit.near)
    # Twice as far as it is wide, its bottom is half a width farther; sides fill the rest.
    mask, depth = look(renderer, data, height=2 * 0.1 * kit.scale)
    assert depth[60, 80] == pytest.approx(2.5 * 0.1 * kit.scale, abs=1e-3)
    assert mask[60, 80 - 60 : 80 + 60].all()
    renderer.close()


def test_what_a_long_lens_sees_is_before_the_far_plane():
    box = trimesh.creation.box([0.02] * 3)
    kit = parts.Kit([parts.Part(box, objects.from_mesh(box, 1, "box"))])
    size = surface.diameter(np.asarray(box.vertices)) * kit.scale
    for focal, far in ((600.0, FAR), (12_000.0, 12_000 / 480 * size / 0.1 * 1.5)):
        k = np.array([[focal, 0, 320], [0, focal, 240], [0, 0, 1]])
        camera = rig.Camera("a", 640, 480, k, np.eye(4), False)
        assert kit.far([camera]) == pytest.approx(far)


def test_a_small_part_next_to_a_camera_is_whole(gl, scene):
    """3 cm away, and as deep as it is; far away depth is still far better than coordinates are."""
    model, data = scene
    small, large = (
        parts.Part(mesh, objects.from_mesh(mesh, number, "box"))
        for number, mesh in enumerate(
            (trimesh.creation.box([0.01] * 3), trimesh.creation.box([0.1] * 3)), 1
        )
    )
    kit = parts.Kit([small, large])
    assert kit.near == pytest.approx(0.1 * parts.SCENE_DIAMETER / np.sqrt(10))
    assert parts.Kit([large]).near < NEAR
    for near, seen in ((NEAR, False), (kit.near, True)):
        renderer = Renderer(model, 160, 120, gl, near)
        mask, depth = look(renderer, data, height=0.23)
        assert mask.all()
        assert np.allclose(depth, 0.03, atol=1e-6) == seen  # else its inside is
        if seen:
            mask, depth = look(renderer, data, height=3.2)
            np.testing.assert_allclose(depth[mask], 3, atol=2e-4)
        renderer.close()

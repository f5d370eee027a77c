"""Meshes of users: what their files give is kept, and what cannot be used is refused."""

import ast
import concurrent.futures
import json
import os
import resource
import signal
import time
import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest
import scipy.spatial
import trimesh
from PIL import Image

from mvtop_train.data import limits, meshfile, objects, surface
from mvtop_train.errors import UserError
from mvtop_train.export import mesh as bundled
from mvtop_train.synthesis import catalogue, parts

BOX = trimesh.creation.box([40, 30, 20])
COLORED = "newmtl a\nKd 0.8 0.1 0.1\n"
PRINTED = "newmtl a\nKd 1 1 1\nmap_Kd print.png\n"


def wavefront(folder, material: str | None, uv=True, color=""):
    """The box as OBJ, its material in a file beside it; None: in a file that is missing."""
    lines = ["mtllib box.mtl", "usemtl a", "vt 0 0", "vt 1 0", "vt 1 1"]
    lines += [f"v {x} {y} {z} {color}" for x, y, z in BOX.vertices]
    for face in BOX.faces + 1:
        corners = [
            f"{vertex}/{place}" if uv else f"{vertex}" for place, vertex in enumerate(face, 1)
        ]
        lines.append("f " + " ".join(corners))
    (folder / "box.obj").write_text("\n".join(lines) + "\n")
    if material is not None:
        (folder / "box.mtl").write_text(material)
    return folder / "box.obj"


def colors_of(mesh) -> set[tuple[int, ...]]:
    """Those of its surface, after what is generated has looked at it; none: without color."""
    obj = objects.from_mesh(mesh, 1, "box")
    if parts.Part(mesh, obj).texture is None:
        return set()
    return {tuple(color) for color in obj.colors.astype(int).tolist()}


@pytest.mark.parametrize("uv", [True, False])
def test_colors_of_materials_are_kept(tmp_path, uv):
    mesh = meshfile.load_mesh(wavefront(tmp_path, COLORED, uv), "mm")
    assert colors_of(mesh) == {(204, 26, 26)}
    objects.write(tmp_path, [(objects.from_mesh(mesh, 1, "box"), mesh)])
    assert colors_of(objects.read_mesh(tmp_path, 1)) == {(204, 26, 26)}


def test_colors_of_gltf_are_linear(tmp_path):
    material = trimesh.visual.material.PBRMaterial(baseColorFactor=[0.5, 0, 1, 1])
    box = BOX.copy()
    box.visual = trimesh.visual.TextureVisuals(material=material)
    box.export(tmp_path / "box.glb")
    assert colors_of(meshfile.load_mesh(tmp_path / "box.glb", "mm")) == {(188, 0, 255)}


@pytest.mark.parametrize("picture", [None, b"no picture"])
def test_a_texture_that_cannot_be_read_is_refused(tmp_path, picture):
    path = wavefront(tmp_path, PRINTED)
    if picture is not None:
        (tmp_path / "print.png").write_bytes(picture)
    with pytest.raises(UserError, match="box.obj: expected the picture print.png .*; fix: "):
        meshfile.load_mesh(path, "mm")


def test_a_texture_in_a_folder_below_is_found(tmp_path):
    (tmp_path / "prints").mkdir()
    cv2.imwrite(str(tmp_path / "prints/print.png"), np.full((8, 8, 3), (30, 20, 10), np.uint8))
    path = wavefront(tmp_path, PRINTED.replace("print", "prints/print"))
    assert colors_of(meshfile.load_mesh(path, "mm")) == {(10, 20, 30)}


def test_only_files_beside_a_mesh_are_read(tmp_path, monkeypatch):
    private = tmp_path / "private.png"
    cv2.imwrite(str(private), np.full((8, 8, 3), 9, np.uint8))
    folder = tmp_path / "meshes"
    folder.mkdir()
    os.mkfifo(folder / "pipe.png")
    (folder / "link.png").symlink_to(private)
    refused = "box.obj: expected files beside it .*{}.*; fix: copy it beside"
    for name in (str(private), "../private.png", "link.png", "pipe.png", "/dev/zero"):
        path = wavefront(folder, PRINTED.replace("print.png", name))
        if name == "/dev/zero":
            path.write_text(path.read_text().replace("box.mtl", name))
        with pytest.raises(UserError, match=refused.format(name)):
            meshfile.load_mesh(path, "mm")
    # Copied there, it is found by the name that the material gives.
    cv2.imwrite(str(folder / "private.png"), np.full((8, 8, 3), (30, 20, 10), np.uint8))
    path = wavefront(folder, PRINTED.replace("print.png", "../private.png"))
    assert colors_of(meshfile.load_mesh(path, "mm")) == {(10, 20, 30)}
    monkeypatch.setattr(meshfile, "MESH_BYTES", 2000)
    (folder / "private.png").write_bytes(bytes(3000))
    with pytest.raises(UserError, match=refused.format("private.png")):
        meshfile.load_mesh(path, "mm")


def test_pictures_of_a_data_set_s_meshes_lie_beside_them_too(tmp_path):
    BOX.export(tmp_path / "box.ply", encoding="ascii")
    text = (tmp_path / "box.ply").read_text()
    (tmp_path / "models").mkdir()
    named = text.replace("ascii 1.0\n", "ascii 1.0\ncomment TextureFile /dev/zero\n")
    (tmp_path / "models/obj_000001.ply").write_text(named)
    with pytest.raises(UserError, match="expected files beside it"):
        objects.read_mesh(tmp_path, 1)


@pytest.mark.parametrize("number", ["nan", "inf"])
def test_coordinates_that_are_none_are_no_matter_of_units(tmp_path, number):
    path = wavefront(tmp_path, None)
    path.write_text(path.read_text().replace("v 20.0 ", f"v {number} "))
    with pytest.raises(UserError, match="box.obj: expected three finite coordinates of each"):
        meshfile.load_mesh(path, "mm")


def test_meshes_that_take_too_much_memory_are_refused_with_the_command_that_decimates(
    tmp_path, monkeypatch
):
    path = tmp_path / "fine.stl"
    trimesh.creation.icosphere(4, 50).export(path)
    monkeypatch.setattr(meshfile, "MESH_TRIANGLES", 5000)
    with pytest.raises(UserError, match="5,000 triangles at most.* got 5,120; fix: .*decimation"):
        meshfile.load_mesh(path, "mm")
    monkeypatch.setattr(meshfile, "MESH_BYTES", 5000)
    with pytest.raises(UserError, match="MiB at most, got a larger one.*; fix: .*decimation"):
        meshfile.load_mesh(path, "mm")


def test_meshes_of_data_sets_are_bounded_as_own_ones_are(tmp_path, monkeypatch):
    (tmp_path / "models").mkdir()
    BOX.export(tmp_path / "models/obj_000001.ply")
    assert len(objects.read_mesh(tmp_path, 1).faces) == 12
    monkeypatch.setattr(meshfile, "MESH_TRIANGLES", 2)
    with pytest.raises(UserError, match="obj_000001.ply: expected 2 triangles at most.*got 12"):
        objects.read_mesh(tmp_path, 1)
    trimesh.PointCloud(BOX.vertices).export(tmp_path / "models/obj_000001.ply")
    with pytest.raises(UserError, match="obj_000001.ply: expected 6 vertices at most.*got 8"):
        objects.read_mesh(tmp_path, 1)
    (tmp_path / "models/obj_000001.ply").write_bytes(b"no mesh")
    with pytest.raises(UserError, match="obj_000001.ply: expected an obj, stl or ply file"):
        objects.read_mesh(tmp_path, 1)


@pytest.mark.skipif(not limits.STATUS.exists(), reason="only Linux bounds memory")
def test_a_mesh_that_asks_for_more_memory_than_any_is_refused(tmp_path):
    zeros = {"buffer": 0, "byteLength": 12}
    sparse = {"count": 1, "values": {"bufferView": 0}}
    sparse["indices"] = {"bufferView": 0, "componentType": 5125}
    accessor = {"componentType": 5126, "count": 300_000_000, "type": "VEC3", "sparse": sparse}
    (tmp_path / "sparse.gltf").write_text(json.dumps({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}], "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [accessor], "bufferViews": [zeros],
        "buffers": [{"byteLength": 12, "uri": f"data:;base64,{'A' * 16}"}],
    }))  # fmt: skip
    before = resource.getrlimit(resource.RLIMIT_DATA)
    with pytest.raises(UserError, match="sparse.gltf: expected a mesh that is read within 3 GiB"):
        meshfile.load_mesh(tmp_path / "sparse.gltf", "mm")
    assert resource.getrlimit(resource.RLIMIT_DATA) == before


def test_a_mesh_that_takes_too_long_is_refused(tmp_path, monkeypatch):
    """Its time grows with the square of its groups."""
    groups = "".join(f"g a{n}\nusemtl m{n}\nf 1 2 3\n" for n in range(60_000))
    (tmp_path / "groups.obj").write_text("v 0 0 0\nv 9 0 0\nv 0 9 0\n" + groups)
    monkeypatch.setattr(meshfile, "MESH_SECONDS", 0.5)
    before, begun = signal.getsignal(signal.SIGPROF), time.process_time()
    with pytest.raises(UserError, match="groups.obj: expected a mesh .* 0.5 s .*; fix: .* as stl"):
        meshfile.load_mesh(tmp_path / "groups.obj", "mm")
    assert time.process_time() - begun < 10
    assert signal.getsignal(signal.SIGPROF) == before
    assert signal.getitimer(signal.ITIMER_PROF) == (0, 0)


def test_time_is_over_also_for_what_swallows_errors():
    swallowed = 0
    with pytest.raises(TimeoutError), limits.processor_time(0.05):
        while swallowed < 3:
            try:
                sum(range(1_000_000))
            except BaseException:
                swallowed += 1
    assert swallowed == 3


def test_threads_other_than_the_main_one_read_as_well(tmp_path):
    BOX.export(tmp_path / "box.ply")
    with concurrent.futures.ThreadPoolExecutor(1) as pool:
        mesh = pool.submit(meshfile.load_mesh, tmp_path / "box.ply", "mm").result()
    assert len(mesh.faces) == 12


def test_archives_are_no_meshes(tmp_path):
    BOX.export(tmp_path / "box.stl")
    with zipfile.ZipFile(tmp_path / "box.zip", "w") as packed:
        packed.write(tmp_path / "box.stl", "box.stl")
    with pytest.raises(UserError, match="box.zip: expected a file of .obj, .stl.*; fix: "):
        meshfile.load_mesh(tmp_path / "box.zip", "mm")


@pytest.mark.parametrize("name", ["print.png", "print.eps"])
def test_a_texture_starts_no_program(name, tmp_path, monkeypatch):
    program, ran = tmp_path / "programs/gs", tmp_path / "ran"
    program.parent.mkdir()
    program.write_text(f"#!/bin/sh\ntouch {ran}\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(program.parent), prepend=os.pathsep)
    monkeypatch.setattr("PIL.EpsImagePlugin.gs_binary", None)  # is looked for anew
    text = "%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 8 8\n%%EndComments\nshowpage\n%%EOF\n"
    (tmp_path / name).write_text(text)
    path = wavefront(tmp_path, PRINTED.replace("print.png", name))
    with pytest.raises(UserError, match=f"expected the picture {name} .*PNG, JPEG"):
        meshfile.load_mesh(path, "mm")
    assert not ran.exists()


def test_every_picture_is_opened_as_one_of_a_few_kinds():
    for path in Path(objects.__file__).parents[1].rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("Image.open"):
                assert "formats" in [word.arg for word in node.keywords], f"{path}:{node.lineno}"


def test_without_a_material_a_mesh_has_the_colors_of_its_vertices_or_none(tmp_path):
    assert colors_of(meshfile.load_mesh(wavefront(tmp_path, None), "mm")) == set()
    red = meshfile.load_mesh(wavefront(tmp_path, None, color="0.8 0.1 0.1"), "mm")
    assert colors_of(red) == {(204, 26, 26)}


def test_vertices_without_triangles_do_not_count(tmp_path):
    stray = trimesh.Trimesh([*BOX.vertices, [500, 0, 0]], BOX.faces, process=False)
    stray.export(tmp_path / "stray.ply")
    obj = objects.from_mesh(meshfile.load_mesh(tmp_path / "stray.ply", "mm"), 1, "box")
    assert obj.diameter_m == pytest.approx(np.linalg.norm([0.04, 0.03, 0.02]))
    trimesh.PointCloud(BOX.vertices).export(tmp_path / "points.ply")
    with pytest.raises(UserError, match="points.ply: expected triangles, got none; fix: "):
        meshfile.load_mesh(tmp_path / "points.ply", "mm")


@pytest.mark.parametrize("turned", [np.arange(12), np.array([1, 2, 7]), np.array([0])])
def test_triangles_are_wound_outwards(turned, tmp_path):
    """Also where seams of a texture part all vertices, and where the box has no lid."""
    box = BOX.copy().apply_translation([60, 0, 0])
    box.faces[turned] = box.faces[turned, ::-1]
    apart = trimesh.Trimesh(
        box.triangles.reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False
    )
    lid = BOX.face_normals[:, 2] > 0.5
    for n, mesh in enumerate((box, apart, trimesh.Trimesh(box.vertices, box.faces[~lid]))):
        mesh.export(tmp_path / f"{n}.ply")
        loaded = meshfile.load_mesh(tmp_path / f"{n}.ply", "mm")
        outwards = loaded.triangles_center - [0.06, 0, 0]
        assert ((loaded.face_normals * outwards).sum(1) > 0).all()


def test_an_origin_far_from_the_part_is_refused(tmp_path):
    diameter = np.linalg.norm(BOX.extents)
    for diameters in (1.9, 2.1):
        away = BOX.copy().apply_translation([0, 0, diameters * diameter])
        away.export(tmp_path / f"{diameters}.stl")
    meshfile.load_mesh(tmp_path / "1.9.stl", "mm")
    with pytest.raises(
        UserError, match="2.1.stl: expected its origin in the part or near it, .* fix"
    ):
        meshfile.load_mesh(tmp_path / "2.1.stl", "mm")


def printed_box() -> trimesh.Trimesh:
    """In metres; seen from above it shows four squares by four, each in a color of its own."""
    # Each triangle has vertices of its own, as at the seams of a texture.
    box = trimesh.Trimesh(BOX.triangles.reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False)
    cells = np.random.default_rng(0).integers(0, 256, (4, 4, 3)).astype(np.uint8)
    image = Image.fromarray(cells.repeat(30, 0).repeat(30, 1))
    box.visual = trimesh.visual.TextureVisuals(
        box.vertices[:, :2] / BOX.extents[:2] + 0.5, image=image
    )
    return box.apply_scale(1e-3)


def test_a_print_on_few_triangles_is_kept(tmp_path):
    box = printed_box()
    obj = objects.from_mesh(box, 1, "box")
    objects.write(tmp_path, [(obj, box)])
    mesh = bundled.meshes_of(tmp_path, objects.read_all(tmp_path))["box"]
    assert len(box.faces) < len(mesh.faces) <= surface.TRIANGLES
    np.testing.assert_allclose(mesh.bounds, box.bounds, atol=1e-8)
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    assert mesh.is_watertight and mesh.volume == pytest.approx(box.volume)
    # Most of the surface is not next to a border of two squares.
    points, colors = surface.sample_surface(box, 2000)
    _, face = scipy.spatial.KDTree(mesh.triangles_center).query(points)
    assert (abs(mesh.visual.face_colors[face, :3] - colors).max(1) < 30).mean() > 0.5


def test_meshes_of_many_triangles_are_not_made_finer():
    fine = trimesh.creation.icosphere(4, 0.05)
    image = Image.fromarray(np.zeros((4, 4, 3), np.uint8))
    fine.visual = trimesh.visual.TextureVisuals(fine.vertices[:, :2], image=image)
    assert np.array_equal(surface.finer(fine).faces, fine.faces)


def test_parts_of_the_catalogue_have_no_color_of_their_own(tmp_path):
    """So that they are rendered in any; a grey one would be learnt as grey."""
    objects.write(tmp_path, catalogue.parts())
    for file in (tmp_path / "models").glob("*.ply"):
        assert trimesh.load(file, process=False).visual.kind is None


def test_edges_are_shaded_sharp_and_round_sides_smooth():
    """Of a pierced block, whose flat sides have long thin triangles around the hole."""
    hole = trimesh.creation.cylinder(0.3, 4, sections=48)
    block = trimesh.boolean.difference([trimesh.creation.box([2, 2, 1]), hole])
    normals, faces = parts.corner_normals(block), block.face_normals
    flat = np.abs(faces).max(1) > 1 - 1e-6
    on_hole = np.linalg.norm(block.triangles[..., :2], axis=-1).max(1) < 0.31
    assert on_hole.sum() >= 96 and (flat & ~on_hole).sum() >= 12
    assert np.allclose(normals[~on_hole], faces[~on_hole][:, None])
    inwards = -block.triangles[on_hole] * [1, 1, 0] / 0.3
    assert np.allclose(normals[on_hole], inwards, atol=1e-3)


def test_seams_of_a_texture_and_triangles_without_area_do_not_show():
    ball = trimesh.creation.icosphere(3)
    whole = parts.corner_normals(ball)
    apart = trimesh.Trimesh(
        ball.triangles.reshape(-1, 3), np.arange(len(ball.faces) * 3).reshape(-1, 3), process=False
    )
    assert np.allclose(parts.corner_normals(apart), whole, atol=1e-6)
    thin = trimesh.Trimesh(ball.vertices, [*ball.faces, [0, 0, 1]], process=False)
    with_it = parts.corner_normals(thin)
    assert np.allclose(with_it[:-1], whole, atol=1e-6)
    assert np.allclose(np.linalg.norm(with_it, axis=-1), 1)


def test_a_mesh_that_cannot_fall_is_refused():
    sheet = trimesh.Trimesh([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]], [[0, 1, 2]])
    with pytest.raises(
        UserError, match="expected a body that can fall, got: at least 4 vertices .*; fix: "
    ):
        parts.Part(sheet, objects.from_mesh(sheet, 1, "sheet"))

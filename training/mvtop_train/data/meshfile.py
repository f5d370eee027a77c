"""Mesh files of a part: read within bounds, as they may be a stranger's, and checked."""

import contextlib
import functools
import hashlib
import io
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image

from .. import files
from ..errors import UserError
from . import limits
from .surface import diameter, outermost

FAR = 2.0  # diameters from a mesh's middle to its origin; beyond, coordinates have too few bits
MESHES = (".obj", ".stl", ".ply", ".off", ".glb", ".gltf")  # that trimesh reads without unpacking
PICTURES = ("PNG", "JPEG", "WEBP", "BMP", "TIFF")  # of materials: Pillow starts programs for others
MESH_TRIANGLES = 300_000  # of a mesh that is rendered; it has three times as many vertices at most
MESH_BYTES = 1 << 28  # of a mesh's file, and of each that it names
MESH_MEMORY = 3 << 30  # bytes, that reading it takes at most
MESH_SECONDS = 120  # of processor time, likewise: the largest with a large texture takes 3
DECIMATE = (
    'a coarser one, pip install fast-simplification; python -c "import trimesh; trimesh.load('
    "'LARGE', force='mesh').simplify_quadric_decimation(face_count=200000).export('SMALL.ply')\""
)
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}


class _Beside(trimesh.resolvers.FilePathResolver):
    """The files that a mesh names, of its own folder and those below it alone: a mesh may be a
    stranger's. trimesh is silent about what it cannot read."""

    def __init__(self, path: Path):
        super().__init__(str(path))
        self.refused, self.unread, self.digest = [], [], hashlib.sha256()

    def absolute(self, name: str) -> Path:
        path = super().absolute(name)
        if path.exists() and not files.is_bounded(path, MESH_BYTES):
            raise ValueError(name)
        return path

    def get(self, name: str) -> bytes:
        if Path(name).suffix.lower() not in Image.registered_extensions():
            return self._read(name)
        try:
            content = self._read(name)
            Image.open(io.BytesIO(content), formats=PICTURES)
            return content
        except Exception:
            self.unread.append(name)
            raise

    def _read(self, name: str) -> bytes:
        try:
            content = super().get(name)
        except ValueError:
            self.refused.append(name)
            raise
        self.digest.update(content)
        return content


@contextlib.contextmanager
def reading(path: Path):
    """Within, trimesh may take bounded memory and time, and pictures of a few kinds; what it raises
    is a `UserError` of the mesh at `path`."""
    every, Image.open = Image.open, functools.partial(Image.open, formats=PICTURES)
    try:
        with limits.memory(MESH_MEMORY), limits.processor_time(MESH_SECONDS):
            yield
    except UserError:
        raise
    except MemoryError:
        raise UserError(
            f"mesh {path}: expected a mesh that is read within {MESH_MEMORY >> 30} GiB of memory, "
            f"got a larger one; fix: {DECIMATE}"
        ) from None
    except TimeoutError:
        raise UserError(
            f"mesh {path}: expected a mesh that is read within {MESH_SECONDS} s of processor time, "
            "got one that takes longer; fix: export the part as one body without groups, as stl"
        ) from None
    except Exception as error:
        raise UserError(
            f"mesh {path}: expected an obj, stl or ply file with triangles, got {error}; "
            "fix: export the part again as one of these"
        ) from None
    finally:
        Image.open = every


def load(path: Path, **options) -> tuple:
    """What trimesh makes of a file, triangles or points, and the `_Beside` that it read other files
    by."""
    path = Path(path)
    if path.suffix.lower() not in MESHES:
        raise UserError(
            f"mesh {path}: expected a file of {', '.join(MESHES)}, got {path.suffix!r}; "
            "fix: export the part as one of these"
        )
    if not files.is_bounded(path, MESH_BYTES):
        raise UserError(
            f"mesh {path}: expected a file of {MESH_BYTES >> 20} MiB at most, got a larger one, or "
            f"none; fix: {DECIMATE}"
        )
    beside = _Beside(path)
    with reading(path):
        mesh = trimesh.load(path, resolver=beside, **options)
        if isinstance(mesh, trimesh.Scene):
            mesh = mesh.to_mesh()
    if beside.refused:
        raise UserError(
            f"mesh {path}: expected files beside it or in a folder there, of "
            f"{MESH_BYTES >> 20} MiB at most, got {beside.refused[0]!r}; "
            "fix: copy it beside the mesh, or take out its line"
        )
    _refuse_many(path, "triangles", len(getattr(mesh, "faces", ())), MESH_TRIANGLES)
    _refuse_many(path, "vertices", len(mesh.vertices), 3 * MESH_TRIANGLES)
    return mesh, beside


def _refuse_many(path: Path, what: str, count: int, most: int):
    if count > most:
        raise UserError(
            f"mesh {path}: expected {most:,} {what} at most, as each process that renders it takes "
            f"5 kB for each triangle, got {count:,}; fix: {DECIMATE}"
        )


def load_mesh(path: Path, unit: str) -> trimesh.Trimesh:
    """A mesh file (obj, stl, ply, ...) in metres; `metadata["beside"]` is a digest of the other
    files that it names."""
    if not Path(path).is_file():
        raise UserError(f"mesh {path}: no such file; fix: check the path")
    # Vertices of STL files are not shared between faces: merge them, for smooth shading.
    merged = Path(path).suffix.lower() == ".stl"
    mesh, beside = load(Path(path), force="mesh", process=merged)
    if len(mesh.faces) == 0:
        raise UserError(
            f"mesh {path}: expected triangles, got none; fix: export the part as a mesh"
        )
    if beside.unread:
        raise UserError(
            f"mesh {path}: expected the picture {beside.unread[0]} of a material, got none "
            f"that can be read ({', '.join(PICTURES)}); fix: put it there, or take its line out of "
            "the material"
        )
    corners = np.asarray(mesh.faces)
    if corners.min() < 0 or corners.max() >= len(mesh.vertices):
        raise UserError(
            f"mesh {path}: expected triangles of its {len(mesh.vertices)} vertices, got one of "
            "others; fix: export the part again"
        )
    if mesh.vertices.shape[1:] != (3,) or not np.isfinite(mesh.vertices).all():
        raise UserError(
            f"mesh {path}: expected three finite coordinates of each vertex, got others; "
            "fix: export the part again"
        )
    _keep_given_colors(mesh)
    mesh.remove_unreferenced_vertices()
    mesh.apply_scale(UNITS[unit])
    mesh.metadata["beside"] = beside.digest.hexdigest()
    size = diameter(outermost(np.asarray(mesh.vertices)))
    if not 0.002 <= size <= 5:
        raise UserError(
            f"mesh {path}: expected a part of 2 mm to 5 m, got {size:.3g} m in unit "
            f"{unit!r}; fix: --mesh-unit ({', '.join(UNITS)})"
        )
    off = float(np.linalg.norm(mesh.bounds.mean(0)))
    if off > FAR * size:
        raise UserError(
            f"mesh {path}: expected its origin in the part or near it, got one {off:.3g} m off the "
            f"middle of a part of {size:.3g} m; fix: move the origin into the part, export it again"
        )
    _turn_outwards(mesh)
    return mesh


def picture(material):
    """The texture of a trimesh material, a PIL image, if it has one."""
    return getattr(material, "image", None) or getattr(material, "baseColorTexture", None)


def _keep_given_colors(mesh: trimesh.Trimesh):
    """Leaves a texture and its place on the mesh, or colors, or none: what the file has."""
    if mesh.visual.kind != "texture":
        return
    material, visuals = mesh.visual.material, trimesh.visual
    if picture(material) == visuals.material.color_image():  # trimesh's own, where there is none
        colors = mesh.vertex_attributes.get("color")
        mesh.visual = visuals.ColorVisuals(mesh, vertex_colors=colors)
    elif mesh.visual.uv is None or picture(material) is None:
        color = visuals.color.to_float(material.main_color)
        if isinstance(material, visuals.material.PBRMaterial):  # whose colors are linear
            color[:3] = visuals.color.linear_to_srgb(color[:3])
        mesh.visual = visuals.ColorVisuals(mesh, face_colors=color)


def _turn_outwards(mesh: trimesh.Trimesh):
    """Winds triangles so that their normals point out of the part, by which it is shaded."""
    # As one where seams of textures part the vertices.
    whole = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    whole.merge_vertices(merge_tex=True, merge_norm=True)
    merged = whole.faces.copy()
    if not whole.is_winding_consistent:
        trimesh.repair.fix_winding(whole)
    turned = (whole.faces != merged).any(1)
    corners = whole.triangles - whole.bounds.mean(0)
    if np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) < 0:
        turned = ~turned
    if turned.any():
        mesh.faces = np.where(turned[:, None], mesh.faces[:, ::-1], mesh.faces)

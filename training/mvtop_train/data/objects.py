"""What is known of an object, from MV-ball or from a mesh, and its place in a data set: `models/`.

    models/models_info.json   BOP's file (mm), with one more key, `name`
    models/obj_000001.ply     the mesh in mm, with vertex colors; made finer where it has a texture
    models_eval/obj_000001.ply  points spread over the surface, on which errors (ADD) are measured

Training, evaluation and export read the object back from there, so that they serve any data set
in BOP layout; without `models_eval/` the points are drawn from the mesh.
"""

import contextlib
import functools
import hashlib
import io
import json
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image

from .. import files
from ..errors import MISLEADING, UserError, asking_mvtop
from ..network.config import ObjectClass
from . import memory, mvball

POINTS = 1200  # on the surface, for ADD and overlays
DIRECTIONS = 600  # in which the outermost points are kept
GREY = 160  # of meshes without color
FAR = 2.0  # diameters from a mesh's middle to its origin; beyond, coordinates have too few bits
TRIANGLES = 2000  # of a bundle's mesh at most: what refinement draws some times in each view
MESHES = (".obj", ".stl", ".ply", ".off", ".glb", ".gltf")  # that trimesh reads without unpacking
PICTURES = ("PNG", "JPEG", "WEBP", "BMP", "TIFF")  # of materials: Pillow starts programs for others
MESH_TRIANGLES = 300_000  # of a mesh that is rendered; it has three times as many vertices at most
MESH_BYTES = 1 << 28  # of a mesh's file, and of each that it names
MESH_MEMORY = 3 << 30  # bytes, that reading it takes at most
DECIMATE = (
    'a coarser one, pip install fast-simplification; python -c "import trimesh; trimesh.load('
    "'LARGE', force='mesh').simplify_quadric_decimation(face_count=200000).export('SMALL.ply')\""
)
INFO = "models_info.json"
FILE_NAME = re.compile(rf'[^/\\:*?"<>|{MISLEADING}]+')  # as an object's is the name of files
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}


@dataclass(frozen=True)
class Object:
    """One rigid object; all lengths in metres, all points in the object's frame."""

    id: int
    name: str
    diameter_m: float  # largest distance between two of its points
    extent_m: float  # largest absolute coordinate: the unit in which coordinates are coded
    points: np.ndarray  # [n, 3] spread over the surface
    colors: np.ndarray  # [n, 3] of these points, 0..255
    bounds: np.ndarray  # [m, 3] outermost points: their projections' extent is the amodal box
    discrete: tuple[tuple[float, ...], ...] = ()  # symmetries, see `ObjectClass`
    continuous: tuple[tuple[float, ...], ...] = ()


def ball() -> Object:
    """The MV-ball."""
    points, colors = mvball.surface_points(POINTS)
    return Object(
        mvball.OBJ_ID, mvball.NAME, mvball.DIAMETER, mvball.EXTENT,
        points, colors, mvball.bounding_points(),
    )  # fmt: skip


def classes_of(*objects: Object) -> tuple[ObjectClass, ...]:
    """The classes of a network for these objects."""
    return tuple(
        ObjectClass(obj.id, obj.name, obj.diameter_m, obj.discrete, obj.continuous)
        for obj in objects
    )


def from_mesh(mesh: trimesh.Trimesh, obj_id: int, name: str, discrete=(), continuous=()) -> Object:
    """The object that `mesh` (metres) is; its symmetries as in `ObjectClass`."""
    bounds = outermost(np.asarray(mesh.vertices))
    points, colors = sample_surface(mesh)
    return Object(
        obj_id, name, diameter(bounds), float(np.abs(mesh.bounds).max()), points, colors, bounds,
        discrete, continuous,
    )  # fmt: skip


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
    """Within, trimesh may take bounded memory, and pictures of a few kinds; what it raises is a
    `UserError` of the mesh at `path`."""
    every, Image.open = Image.open, functools.partial(Image.open, formats=PICTURES)
    try:
        with memory.at_most(MESH_MEMORY):
            yield
    except UserError:
        raise
    except MemoryError:
        raise UserError(
            f"mesh {path}: expected a mesh that is read within {MESH_MEMORY >> 30} GiB of memory, "
            f"got a larger one; fix: {DECIMATE}"
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


def directions(n: int) -> np.ndarray:
    """Unit vectors [n, 3] spread evenly over the sphere (Fibonacci lattice)."""
    z = 1 - (2 * np.arange(n) + 1) / n
    angle = np.pi * (1 + np.sqrt(5)) * np.arange(n)
    radius = np.sqrt(1 - z**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], 1)


def outermost(points: np.ndarray) -> np.ndarray:
    """The points [m, 3] that lie farthest out in some of many directions."""
    some = np.array_split(directions(DIRECTIONS), 20)  # all at once take 5 kB for each point
    return points[np.unique(np.concatenate([(points @ to.T).argmax(0) for to in some]))]


def diameter(points: np.ndarray) -> float:
    return float(np.linalg.norm(points[:, None] - points, axis=-1).max())


def sample_surface(mesh: trimesh.Trimesh, n: int = POINTS) -> tuple[np.ndarray, np.ndarray]:
    """Points [n, 3] drawn evenly from the surface and their colors [n, 3] in 0..255."""
    if mesh.visual.kind == "texture":
        points, _, colors = trimesh.sample.sample_surface(mesh, n, sample_color=True, seed=0)
        return np.asarray(points), np.asarray(colors)[:, :3].astype(float)
    points, faces = trimesh.sample.sample_surface(mesh, n, seed=0)
    if mesh.visual.kind is None:
        return np.asarray(points), np.full((n, 3), float(GREY))
    return np.asarray(points), mesh.visual.face_colors[faces, :3].astype(float)


def ball_mesh() -> trimesh.Trimesh:
    """The MV-ball as triangles, metres: seen from its center, each direction has one radius."""
    mesh = trimesh.creation.icosphere(subdivisions=5)
    towards = np.asarray(mesh.vertices)
    radius = np.full(len(towards), mvball.BALL_RADIUS)
    color = np.tile(np.array(mvball.COLORS["ball"]), (len(towards), 1))
    for name, axis in mvball.BUMPS.items():
        along = towards @ axis * mvball.BUMP_CENTER
        across = mvball.BUMP_RADIUS**2 - mvball.BUMP_CENTER**2 + along**2
        far = along + np.sqrt(across.clip(0))
        bump = (across > 0) & (far > mvball.BALL_RADIUS)
        radius[bump], color[bump] = far[bump], mvball.COLORS[name]
    vertices = towards * radius[:, None]
    return trimesh.Trimesh(
        vertices, mesh.faces, vertex_colors=np.round(color * 255).astype(np.uint8)
    )


def write(root: Path, parts: list[tuple[Object, trimesh.Trimesh]]):
    """Write objects (each with its mesh, metres) as those of the data set at `root`."""
    for name in ("models", "models_eval"):
        (root / name).mkdir(parents=True, exist_ok=True)
    infos = {str(obj.id): _info(obj, mesh) for obj, mesh in parts}
    (root / "models" / INFO).write_text(json.dumps(infos, indent=1))
    for obj, mesh in parts:
        file = f"obj_{obj.id:06d}.ply"
        colors = None  # it has any, and stays so when it is read
        if mesh.visual.kind == "texture":
            mesh = finer(mesh)
            colors = np.asarray(mesh.visual.to_color().vertex_colors)[:, :3]
        elif mesh.visual.kind is not None:
            colors = np.asarray(mesh.visual.vertex_colors)[:, :3]
        plain = trimesh.Trimesh(
            mesh.vertices * 1e3, mesh.faces, process=False, vertex_colors=colors
        )
        plain.export(root / "models" / file, vertex_normal=False)
        cloud = trimesh.PointCloud(obj.points * 1e3, colors=obj.colors.round().astype(np.uint8))
        cloud.export(root / "models_eval" / file)


def finer(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """A textured mesh in up to `TRIANGLES`, the longest edges cut first, to be colored at vertices.

    An edge is cut where it is the longest of all its triangles, so that no gap comes about. More
    triangles would be decimated again, which fails where vertices lie on a line.
    """
    vertices = np.hstack([mesh.vertices, mesh.visual.uv])
    faces = np.array(mesh.faces)
    while True:
        # Vertices in one place are one where seams of the texture part them.
        places, place = np.unique(vertices[:, :3], axis=0, return_inverse=True)
        sides = np.sort(place.reshape(-1)[np.stack([faces, np.roll(faces, -1, 1)], 2)], 2)
        edges, edge = np.unique(sides.reshape(-1, 2), axis=0, return_inverse=True)
        edge = edge.reshape(-1, 3)  # of each side of each triangle
        length = np.linalg.norm(places[edges[:, 0]] - places[edges[:, 1]], axis=1)
        rank = length.argsort().argsort()  # no two are alike, as lengths may be
        side = rank[edge].argmax(1)
        mine = edge[np.arange(len(faces)), side]
        agreed = np.bincount(mine, minlength=len(edges)) == np.bincount(edge.ravel())
        cut = np.flatnonzero((agreed & (length > length.max() / 2))[mine])
        if not len(cut) or len(faces) + len(cut) > TRIANGLES:
            break
        a, b, c = (faces[cut, (side[cut] + n) % 3] for n in range(3))
        ends, middle = np.unique(np.sort(np.stack([a, b], 1), 1), axis=0, return_inverse=True)
        middle = middle.reshape(-1) + len(vertices)
        vertices = np.vstack([vertices, vertices[ends].mean(1)])
        faces[cut, (side[cut] + 1) % 3] = middle
        faces = np.vstack([faces, np.stack([middle, b, c], 1)])
    visual = trimesh.visual.TextureVisuals(vertices[:, 3:], mesh.visual.material)
    return trimesh.Trimesh(vertices[:, :3], faces, visual=visual, process=False)


def _info(obj: Object, mesh: trimesh.Trimesh) -> dict:
    low, high = mesh.bounds * 1e3
    info = {"diameter": obj.diameter_m * 1e3, "name": obj.name}
    for axis, start, size in zip("xyz", low.tolist(), (high - low).tolist(), strict=True):
        info |= {f"min_{axis}": start, f"size_{axis}": size}
    if obj.discrete:  # translations in mm there
        turns = np.reshape(obj.discrete, (-1, 4, 4)) * [[1, 1, 1, 1e3]] * 1.0
        turns[:, 3, 3] = 1
        info["symmetries_discrete"] = turns.reshape(-1, 16).tolist()
    if obj.continuous:
        info["symmetries_continuous"] = [
            {"axis": list(turn[:3]), "offset": [x * 1e3 for x in turn[3:]]}
            for turn in obj.continuous
        ]
    return info


def read(root: Path, obj_id: int | None = None) -> Object:
    """The object of the data set at `root`; `obj_id` chooses where there are several."""
    infos = _infos(root)
    if obj_id is None and len(infos) > 1:
        raise UserError(
            f"object of {root}: expected one of {sorted(infos)}, got none chosen; "
            f"fix: --object {min(infos)}"
        )
    (obj,) = read_all(root, () if obj_id is None else (obj_id,))
    return obj


def read_all(root: Path, ids: tuple[int, ...] = ()) -> tuple[Object, ...]:
    """The objects of the data set at `root`, by their ids; `ids` chooses some of them."""
    infos = _infos(root)
    for obj_id in ids:
        if obj_id not in infos:
            raise UserError(
                f"object of {root}: expected one of {sorted(infos)}, got {obj_id}; "
                f"fix: --object {min(infos)}"
            )
    return tuple(_object(Path(root), obj_id, infos[obj_id]) for obj_id in ids or sorted(infos))


def _infos(root: Path) -> dict:
    path = Path(root) / "models" / INFO
    if not path.exists():
        raise UserError(
            f"{path}: no such file, expected a data set in BOP layout in {root}; "
            f"fix: mvtop-train generate --out {root}"
        )
    infos = read_infos(path)
    for number, info in infos.items():
        if info.name and not FILE_NAME.fullmatch(info.name):
            raise UserError(
                f"{path}: expected names that files can have, got {info.name!r} of object "
                f"{number}; fix: another name there"
            )
    return infos


def read_infos(path: Path) -> dict:
    """What BOP's `models_info.json` says of each object, by its id (`mvtop.bop.ModelInfo`)."""
    with asking_mvtop("see docs/how-to/data-sets.md"):
        import mvtop  # loads its compiled part

        return mvtop.bop.read_models_info(path)


def symmetries(info) -> tuple[tuple, tuple]:
    """Discrete and continuous ones of a `ModelInfo`, as in `ObjectClass`."""
    return (
        tuple(tuple(turn.ravel().tolist()) for turn in info.symmetries_discrete),
        tuple((*axis.tolist(), *point.tolist()) for axis, point in info.symmetries_continuous),
    )


def _object(root: Path, obj_id: int, info) -> Object:
    file = f"obj_{obj_id:06d}.ply"
    mesh = read_mesh(root, obj_id)
    points, colors = _points(root, file, mesh)
    return Object(
        obj_id,
        info.name or Path(file).stem,
        info.diameter_m,
        float(np.abs(mesh.bounds if info.bounds is None else info.bounds).max()),
        points,
        colors,
        outermost(np.asarray(mesh.vertices)),
        *symmetries(info),
    )


def read_mesh(root: Path, obj_id: int) -> trimesh.Trimesh:
    """The object's mesh in metres; points alone, of early data sets of ours, come as they are."""
    path = Path(root) / "models" / f"obj_{obj_id:06d}.ply"
    if not path.exists():
        raise UserError(
            f"{path}: no such file, expected the object's mesh (PLY, mm); fix: put it there"
        )
    return _read_ply(path)


def _points(root: Path, file: str, mesh) -> tuple[np.ndarray, np.ndarray]:
    """Surface points [n, 3] in metres and their colors [n, 3]: those kept, else new ones."""
    path = root / "models_eval" / file
    kept = _read_ply(path) if path.exists() else mesh
    if isinstance(kept, trimesh.Trimesh):  # as others have it there, a coarser mesh
        return sample_surface(mesh)
    chosen = np.random.default_rng(0).permutation(len(kept.vertices))[:POINTS]
    chosen.sort()
    return np.asarray(kept.vertices)[chosen], np.asarray(kept.colors)[chosen, :3].astype(float)


def _read_ply(path: Path):
    """In metres."""
    mesh, _ = load(path, process=False)
    return mesh.apply_scale(1e-3)

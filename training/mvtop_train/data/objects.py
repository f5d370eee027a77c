"""What is known of an object, from MV-ball or from a mesh, and its place in a data set: `models/`.

    models/models_info.json   BOP's file (mm), with one more key, `name`
    models/obj_000001.ply     the mesh in mm, with vertex colors; made finer where it has a texture
    models_eval/obj_000001.ply  points spread over the surface, on which errors (ADD) are measured

Training, evaluation and export read the object back from there, so that they serve any data set
in BOP layout; without `models_eval/` the points are drawn from the mesh.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

from ..errors import UserError, asking_mvtop, misleads
from ..network.config import ObjectClass
from . import mvball
from .meshfile import load
from .surface import POINTS, diameter, finer, outermost, sample_surface

INFO = "models_info.json"
NO_FILE_NAME = frozenset('/\\:*?"<>|')  # characters, as an object's name is that of files


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


def is_file_name(text: str) -> bool:
    return bool(text) and not any(c in NO_FILE_NAME or misleads(c) for c in text)


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
        if info.name and not is_file_name(info.name):
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

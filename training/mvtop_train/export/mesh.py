"""Meshes of a bundle's objects, on which `mvtop-cli infer` refines poses: `<class>.mesh.ply`.

    mvtop-train mesh --bundle models/mine --data data/mine

Adds them to a bundle that was exported without; its networks stay as they are. Without --data: the
MV-ball. Meshes of more than 2,000 triangles are decimated, with colors taken from the surface.
"""

import hashlib
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from .. import description
from ..data import mvball, objects, surface
from ..errors import UserError, argument_parser, command

COLOR_POINTS = 40_000  # on the surface, from which vertices of decimated meshes take their colors
NEAREST = 4  # of these points, whose mean a vertex has
# Colors that differ by less in each channel are one. A mesh of more than so many is textured, as by
# the setting `refine.max_segments`.
ONE_COLOR = 70
MOST_COLORS = 4


def ball() -> trimesh.Trimesh:
    """The MV-ball, metres: three spheres united, so that its edges are where they meet."""
    parts = [("ball", np.zeros(3), mvball.BALL_RADIUS, 3)]
    parts += [
        (name, axis * mvball.BUMP_CENTER, mvball.BUMP_RADIUS, 2)
        for name, axis in mvball.BUMPS.items()
    ]
    spheres = []
    for _, center, radius, subdivisions in parts:
        sphere = trimesh.creation.icosphere(subdivisions)
        # Of the true volume: as much of the surface lies outside the true one as inside.
        sphere.apply_scale(radius * (4 / 3 * np.pi / sphere.volume) ** (1 / 3))
        sphere.apply_translation(center)
        spheres.append(sphere)
    united = trimesh.boolean.union(spheres, engine="manifold")
    off = [
        np.abs(np.linalg.norm(united.triangles_center - center, axis=1) - radius)
        for _, center, radius, _ in parts
    ]
    part = np.argmin(off, axis=0)
    colors = np.round(np.array([mvball.COLORS[name] for name, *_ in parts]) * 255)
    # Each triangle has vertices of its own, as those on a border have two colors.
    return trimesh.Trimesh(
        united.triangles.reshape(-1, 3), np.arange(3 * len(part)).reshape(-1, 3), process=False,
        vertex_colors=np.repeat(colors[part], 3, axis=0).astype(np.uint8),
    )  # fmt: skip


def decimated(mesh: trimesh.Trimesh, triangles: int = surface.TRIANGLES) -> trimesh.Trimesh:
    """`mesh` with at most so many triangles, and a color of each vertex."""
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    if len(faces) > triangles:
        # Texture seams cut the surface: where they are not merged, decimation tears it there.
        whole = trimesh.Trimesh(vertices, faces, process=False)
        whole.merge_vertices(merge_tex=True, merge_norm=True)
        try:
            import fast_simplification
        except ImportError:
            raise UserError(
                f"mesh of {len(faces)} triangles: expected {triangles} at most, or the package "
                "that decimates it; fix: pip install fast-simplification"
            ) from None
        vertices, faces = fast_simplification.simplify(
            np.asarray(whole.vertices, np.float32),
            np.asarray(whole.faces, np.int32),
            target_count=triangles,
        )
    points, colors = surface.sample_surface(mesh, COLOR_POINTS)
    tree, few = cKDTree(points), few_colors(colors)
    if few is not None:
        return in_few_colors(vertices, faces, tree, *few)
    _, nearest = tree.query(vertices, NEAREST)
    colors = colors[nearest].mean(1).round().astype(np.uint8)
    return trimesh.Trimesh(vertices, faces, process=False, vertex_colors=colors)


def few_colors(colors: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """The colors of a part that has two or a few, and which of them each of `colors` is."""
    known, label = [], np.full(len(colors), -1)
    for n in range(MOST_COLORS + 1):
        rest = np.flatnonzero(label < 0)
        if not len(rest):
            return (np.array(known), label) if len(known) > 1 else None
        alike = rest[abs(colors[rest] - colors[rest[0]]).max(1) < ONE_COLOR]
        label[alike] = n
        known.append(np.median(colors[alike], 0))  # of a border, few are in between
    return None


def in_few_colors(vertices, faces, tree: cKDTree, known, label) -> trimesh.Trimesh:
    """Each triangle in one of the colors, that of most points next to its middle.

    Triangles have vertices of their own, as those on a border have two colors: a mean of both would
    be a third.
    """
    corners = np.asarray(vertices, float)[faces]
    _, nearest = tree.query(corners.mean(1), NEAREST)
    votes = np.stack([(label[nearest] == n).sum(1) for n in range(len(known))], 1)
    colors = known[votes.argmax(1)].round().astype(np.uint8)
    return trimesh.Trimesh(
        corners.reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3), process=False,
        vertex_colors=np.repeat(colors, 3, axis=0),
    )  # fmt: skip


def add(bundle: Path, meshes: dict[str, trimesh.Trimesh]):
    """Write the meshes (metres) of classes, by name, into a bundle that is there."""
    about = description.read(bundle)
    classes = {known["name"]: known for known in about["classes"]}
    for name, mesh in meshes.items():
        if name not in classes:
            raise UserError(
                f"{bundle}: expected a bundle of {name!r}, got one of {sorted(classes)}; "
                "fix: --data must name the data set that it was trained on"
            )
        file = f"{name}.mesh.ply"
        content = mesh.export(file_type="ply", vertex_normal=False)
        (bundle / file).write_bytes(content)
        classes[name]["mesh"] = file
        digest = hashlib.sha256(content).hexdigest()
        about["files"][file] = {"sha256": digest, "bytes": len(content)}
    description.write(bundle, about)


def meshes_of(data: Path | None, known: tuple[objects.Object, ...]) -> dict[str, trimesh.Trimesh]:
    """By name; what the data set has as points alone is left out."""
    if data is None:
        return {mvball.NAME: ball()}
    read = {obj.name: objects.read_mesh(data, obj.id) for obj in known}
    return {
        # The ball is made of spheres, which its data set has in small triangles.
        name: ball() if name == mvball.NAME else decimated(mesh)
        for name, mesh in read.items()
        if isinstance(mesh, trimesh.Trimesh)
    }


@command
def main():
    parser = argument_parser(__doc__)
    parser.add_argument("--bundle", type=Path, required=True, help="folder of the bundle")
    parser.add_argument("--data", type=Path, help="data set of the objects, if not MV-ball")
    args = parser.parse_args()
    known = objects.read_all(args.data) if args.data else (objects.ball(),)
    names = {of["name"] for of in description.read(args.bundle)["classes"]}
    meshes = meshes_of(args.data, tuple(obj for obj in known if obj.name in names))
    add(args.bundle, meshes)
    for name, mesh in meshes.items():
        print(f"{args.bundle / f'{name}.mesh.ply'}: {len(mesh.faces)} triangles")


if __name__ == "__main__":
    main()

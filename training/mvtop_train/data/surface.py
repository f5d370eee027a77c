"""The surface of a mesh: its size, points on it, and a finer one where it has a texture."""

import numpy as np
import trimesh

POINTS = 1200  # on the surface, for ADD and overlays
DIRECTIONS = 600  # in which the outermost points are kept
GREY = 160  # of meshes without color
TRIANGLES = 2000  # of a bundle's mesh at most: what refinement draws some times in each view


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

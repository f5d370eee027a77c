"""Industrial parts made by a script, with the symmetries that they have by construction.

    mvtop-train catalogue --out data/catalogue

Writes BOP's `models/`: PLY meshes in mm and `models_info.json`, as `--mesh` of
`mvtop_train.generate` takes them. Eight parts without texture: a hex nut (turns by sixths, and
upside down), a pipe tee (a half turn), a stepped shaft (any turn about its axis), an angle bracket
(none), a flange (turns by quarters), an elbow (a half turn), a U bracket and a valve body (none).
"""

from pathlib import Path

import numpy as np
import trimesh
from trimesh.creation import box, cylinder

from ..data import objects
from ..errors import argument_parser, command

SECTIONS = 48  # of round surfaces


def round_bar(radius: float, length: float, axis=(0, 0, 1), middle=(0, 0, 0)) -> trimesh.Trimesh:
    """A cylinder, mm, about `axis` through its middle."""
    turn = trimesh.geometry.align_vectors([0, 0, 1], axis)
    turn[:3, 3] = middle
    return cylinder(radius, length, sections=SECTIONS, transform=turn)


def _without(body, *holes) -> trimesh.Trimesh:
    return trimesh.boolean.difference([body, *holes])


def _together(*bodies) -> trimesh.Trimesh:
    return trimesh.boolean.union(bodies)


def hex_nut() -> trimesh.Trimesh:
    prism = cylinder(30 / np.sqrt(3), 14, sections=6)
    return _without(prism, round_bar(8.5, 20))


def pipe_tee() -> trimesh.Trimesh:
    run, branch = round_bar(14, 80, (1, 0, 0)), round_bar(14, 40, (0, 0, 1), (0, 0, 20))
    rims = [round_bar(17, 10, (1, 0, 0), (x, 0, 0)) for x in (-35, 35)]
    rims.append(round_bar(17, 10, (0, 0, 1), (0, 0, 35)))
    inner = [round_bar(10.5, 90, (1, 0, 0)), round_bar(10.5, 50, (0, 0, 1), (0, 0, 25))]
    return _without(_together(run, branch, *rims), *inner)


def stepped_shaft() -> trimesh.Trimesh:
    steps = ((9, 30, -35), (14, 25, -7.5), (18, 8, 9), (11, 37, 31.5))
    return _together(*(round_bar(r, length + 0.02, middle=(0, 0, z)) for r, length, z in steps))


def angle_bracket() -> trimesh.Trimesh:
    foot = box(bounds=[[-30, -20, -3], [30, 20, 3]])
    wall = box(bounds=[[-30, 14, 0], [14, 20, 45]])
    rib = box(bounds=[[-30, -10, 0], [-25, 16, 22]])
    holes = [
        round_bar(4.5, 20, (0, 0, 1), (18, -8, 0)),
        round_bar(4.5, 20, (0, 0, 1), (-12, -8, 0)),
    ]
    holes.append(round_bar(7, 20, (0, 1, 0), (-6, 17, 28)))
    return _without(_together(foot, wall, rib), *holes)


def flange() -> trimesh.Trimesh:
    body = _together(round_bar(32, 8), round_bar(17, 26, middle=(0, 0, 9)))
    bolts = [round_bar(4, 20, middle=(x, y, 0)) for x in (-17, 17) for y in (-17, 17)]
    return _without(body, round_bar(11, 60), *bolts)


def elbow() -> trimesh.Trimesh:
    arms = [round_bar(13, 46, (1, 0, 0), (23, 0, 0)), round_bar(13, 46, (0, 0, 1), (0, 0, 23))]
    corner = trimesh.creation.icosphere(3, 13)
    rims = [round_bar(16.5, 9, (1, 0, 0), (41, 0, 0)), round_bar(16.5, 9, (0, 0, 1), (0, 0, 41))]
    inner = [round_bar(9.5, 60, (1, 0, 0), (30, 0, 0)), round_bar(9.5, 60, (0, 0, 1), (0, 0, 30))]
    body = _without(_together(*arms, corner, *rims), *inner)
    return body.apply_translation([-18, 0, -18])


def u_bracket() -> trimesh.Trimesh:
    foot = box(bounds=[[-30, -15, -12], [30, 15, -7]])
    high = box(bounds=[[-30, -15, -12], [-25, 15, 23]])
    low = box(bounds=[[25, -15, -12], [30, 15, 10]])
    holes = [
        round_bar(6, 20, (1, 0, 0), (-28, 0, 12)),
        round_bar(4, 20, (1, 0, 0), (28, 3, 1)),
        round_bar(5, 20, (0, 0, 1), (-8, 0, -10)),
        round_bar(3, 20, (0, 0, 1), (14, 6, -10)),
    ]
    return _without(_together(foot, high, low), *holes)


def valve_body() -> trimesh.Trimesh:
    block = box(bounds=[[-25, -18, -15], [25, 18, 15]])
    ports = [
        round_bar(10, 14, (0, 0, 1), (-8, 0, 20)),
        round_bar(7, 12, (1, 0, 0), (30, 4, 0)),
    ]
    bores = [
        round_bar(6, 60, (0, 0, 1), (-8, 0, 10)),
        round_bar(4, 40, (1, 0, 0), (30, 4, 0)),
        round_bar(5, 60, (0, 1, 0), (12, 0, -4)),
    ]
    return _without(_together(block, *ports), *bores)


def turn(axis, degrees: float) -> np.ndarray:
    return trimesh.transformations.rotation_matrix(np.deg2rad(degrees), axis)


def turns(*poses) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(pose.ravel().tolist()) for pose in poses)


SIXTHS = [turn([0, 0, 1], 60 * n) for n in range(6)]
UPSIDE_DOWN = turn([1, 0, 0], 180)
# name: (how it is made, discrete symmetries but the identity, continuous ones: axis and a point)
CATALOGUE = {
    "hex_nut": (hex_nut, turns(*SIXTHS[1:], *(s @ UPSIDE_DOWN for s in SIXTHS)), ()),
    "pipe_tee": (pipe_tee, turns(turn([0, 0, 1], 180)), ()),
    "stepped_shaft": (stepped_shaft, (), ((0.0, 0.0, 1.0, 0.0, 0.0, 0.0),)),
    "angle_bracket": (angle_bracket, (), ()),
    "flange": (flange, turns(*(turn([0, 0, 1], 90 * n) for n in (1, 2, 3))), ()),
    "elbow": (elbow, turns(turn([1, 0, 1], 180)), ()),
    "u_bracket": (u_bracket, (), ()),
    "valve_body": (valve_body, (), ()),
}


def parts() -> list[tuple[objects.Object, trimesh.Trimesh]]:
    """All of them with their meshes, metres."""
    made = []
    for number, (name, (make, discrete, continuous)) in enumerate(CATALOGUE.items(), 1):
        mesh = make().apply_scale(1e-3)
        made.append((objects.from_mesh(mesh, number, name, discrete, continuous), mesh))
    return made


@command
def main():
    parser = argument_parser(__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder, gets models/")
    args = parser.parse_args()
    found = parts()
    objects.write(args.out, found)
    for obj, mesh in found:
        print(f"{obj.id} {obj.name}: {obj.diameter_m * 1e3:.0f} mm, {len(mesh.faces)} triangles")


if __name__ == "__main__":
    main()

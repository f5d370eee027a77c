"""STEP files as triangles, by cascadio (Open CASCADE) in a process of its own, which may crash.

It may take the memory of other meshes. Its time is bounded from outside, as no error of Python's
ends what Open CASCADE computes.

A STEP file states its unit of length. One that does not is taken in that of `--mesh-unit`.
"""

import importlib.util
import re
import subprocess
import tempfile
from pathlib import Path

import trimesh

from .. import children
from ..data.meshfile import MESH_BYTES, MESH_MEMORY, UNITS, reading
from ..errors import UserError, printable

ENDINGS = (".step", ".stp")
CHORD = 0.001  # of an edge's length: how far a triangle may be off the surface
ANGLE = 0.3  # radians, between two triangles of a curved surface
MINUTES = 20  # for one file
UNIT = re.compile(rb"SI_UNIT\s*\([^)]*\.METRE\.\s*\)|LENGTH_UNIT\s*\(\s*\)", re.IGNORECASE)
ASSUMED = "mm"  # by Open CASCADE, where a file states no unit
SCRIPT = """
import sys
import cascadio
from mvtop_train.data import limits
source, target, chord, angle, memory = sys.argv[1:]
with limits.memory(int(memory)):
    code = cascadio.step_to_glb(
        source, target, tol_linear=float(chord), tol_angular=float(angle), tol_relative=True
    )
sys.exit(1 if code else 0)
"""


def is_step(path: str | Path) -> bool:
    return Path(path).suffix.lower() in ENDINGS


def states_unit(path: Path) -> bool:
    """Whether a STEP file says in which unit its lengths are."""
    return UNIT.search(path.read_bytes()) is not None


def to_mesh(path: str | Path, unit: str | None, target: Path):
    """Write the STEP file at `path` as `target`, a GLB in metres.

    unit  of the file, where it states none
    """
    path = Path(path)
    if not path.is_file() or path.stat().st_size > MESH_BYTES:
        raise UserError(
            f"mesh {path}: expected a file of {MESH_BYTES >> 20} MiB at most, got a larger one, or "
            "none; fix: check the path, or export the part alone"
        )
    if importlib.util.find_spec("cascadio") is None:
        raise UserError(
            f"mesh {path}: expected the reader of STEP files, got none installed; "
            "fix: pip install 'mvtop-train[step]', or export the part as stl"
        )
    stated = states_unit(path)
    if not stated and unit is None:
        raise UserError(
            f"mesh {path}: expected a unit of length in the file or by --mesh-unit, got none; "
            f"fix: --mesh-unit ({', '.join(UNITS)})"
        )
    if stated and unit is not None:
        name = printable(path.name)
        print(f"note: {name}: the unit that the file states is taken, not --mesh-unit {unit}")
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=target.parent) as folder:
        made = Path(folder) / target.name
        _convert(path, made)
        if not stated and unit != ASSUMED:
            with reading(path):
                scene = trimesh.load_scene(made)
                scene.apply_scale(UNITS[unit] / UNITS[ASSUMED])
                scene.export(made)
        made.replace(target)


def _convert(path: Path, target: Path):
    command = children.python("-c", SCRIPT, path, target, CHORD, ANGLE, MESH_MEMORY)
    try:
        done = subprocess.run(command, capture_output=True, timeout=MINUTES * 60, check=False)
    except subprocess.TimeoutExpired:
        raise UserError(
            f"mesh {path}: expected to be read within {MINUTES} minutes, got no end; "
            "fix: export the part with fewer details, or as stl"
        ) from None
    if done.returncode or not target.is_file() or not target.stat().st_size:
        raise UserError(
            f"mesh {path}: expected a STEP file with surfaces, got one that Open CASCADE cannot "
            f"read within {MESH_MEMORY >> 30} GiB of memory; fix: export the part again (AP203, "
            "AP214 or AP242), with fewer details, or as stl"
        )

"""Mesh files changed at random: each is a mesh, or refused in one sentence.

CASES=5000 python -m pytest training/tests/test_mesh_fuzz.py    # longer
"""

import os
import random

import numpy as np
import pytest
import trimesh

from mvtop_train.data import meshfile
from mvtop_train.errors import UserError

CASES = int(os.environ.get("CASES", 60))
KINDS = ["ply", "ply_ascii", "stl", "stl_ascii", "obj", "off", "glb", "gltf"]
NUMBERS = [b"nan", b"inf", b"-1", b"0", b"1e38", b"99999999999", b"", b"4294967295"]


def file_of(kind: str) -> bytes:
    mesh = trimesh.creation.icosphere(subdivisions=1, radius=0.05)
    mesh.visual.vertex_colors = np.arange(mesh.vertices.size).reshape(-1, 3) % 255
    if kind == "ply_ascii":
        return mesh.export(file_type="ply", encoding="ascii")
    if kind == "gltf":  # one file, its numbers within
        made = mesh.export(file_type="gltf", embed_buffers=True)["model.gltf"]
    else:
        made = mesh.export(file_type=kind)
    return made.encode() if isinstance(made, str) else made


def changed(good: bytes, draw: random.Random) -> bytes:
    """Bytes of a file with one to three faults."""
    data = bytearray(good)
    for _ in range(draw.randint(1, 3)):
        at, length = draw.randrange(len(data) + 1), draw.randint(1, 12)
        fault = draw.randrange(5)
        if fault == 0:
            del data[at:]
        elif fault == 1:
            del data[at : at + length]
        elif fault == 2:
            data[at : at + length] = draw.randbytes(length)
        elif fault == 3:
            data[at:at] = data[at : at + 40 * length]
        else:
            data[at : at + length] = draw.choice(NUMBERS)
    return bytes(data)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", KINDS)
def test_changed_meshes_are_meshes_or_refused(kind, tmp_path):
    good, draw = file_of(kind), random.Random(kind)
    path = tmp_path / f"part.{kind.split('_')[0]}"
    path.write_bytes(good)
    assert len(meshfile.load_mesh(path, "m").faces) == 80
    refused = 0
    for case in range(CASES):
        path.write_bytes(changed(good, draw))
        try:
            mesh = meshfile.load_mesh(path, "m")
        except UserError as error:
            refused += 1
            assert f"mesh {path}: expected" in str(error), case
            continue
        assert np.isfinite(mesh.vertices).all() and len(mesh.faces) > 0, case
    assert refused > 0

"""The benchmarks: whether what they call is there, their scenes and their figures."""

import ast
import importlib
import sys
import types
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
BENCHES = ROOT / "benches"
sys.path.insert(0, str(BENCHES))

import predict  # noqa: E402
import predict_scene  # noqa: E402


def modules(tree: ast.Module) -> dict:
    """Modules of mvtop_train that a file imports, by their names in it; each name is there."""
    found = {}
    for node in ast.walk(tree):
        module = node.module or "" if isinstance(node, ast.ImportFrom) else ""
        if not module.startswith("mvtop_train"):
            continue
        parent = importlib.import_module(module)
        for name in node.names:
            if not hasattr(parent, name.name):
                importlib.import_module(f"{module}.{name.name}")
            one = getattr(parent, name.name)
            if isinstance(one, types.ModuleType):
                found[name.asname or name.name] = one
    return found


@pytest.mark.parametrize("path", sorted(BENCHES.glob("*.py")), ids=lambda path: path.name)
def test_what_a_benchmark_uses_of_the_training_is_there(path):
    tree = ast.parse(path.read_text())
    known = modules(tree)
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            module = known.get(node.value.id)
            assert module is None or hasattr(module, node.attr), f"{node.value.id}.{node.attr}"


def test_a_scene_shows_its_parts_in_each_view():
    table = predict_scene.Table(ROOT / "models/ycbv4")
    empty, full = (table.render(1, count, (160, 120), 2) for count in (0, 3))
    for nothing, parts in zip(empty, full, strict=True):
        assert parts.shape == (120, 160, 3)
        # A floor is smooth.
        changes = [np.abs(np.diff(image.astype(int), axis=1)).max() for image in (nothing, parts)]
        assert changes[0] < 10 < 30 < changes[1]


def row(cores: int, **stages: float) -> dict:
    per_second = {count: cores * rate for count, rate in ((1, 2.0), (2, 2.5))}
    about = {"case": {"cores": cores}, "per_second": per_second}
    return about | {"stages_ms": stages, "tracked_ms": None}


def test_the_serial_share_is_what_a_second_core_does_not_shorten():
    # `refine` is halved; of 100 ms of `crop` 40 stay as they are, and 60 are halved.
    rows = [row(1, refine=300.0, crop=100.0), row(2, refine=150.0, crop=70.0)]
    shares = predict.serial(rows)
    assert shares == pytest.approx({"refine": 0.0, "crop": 0.4, "total": 0.1})
    note, of_callers = predict.notes({"cores": {"rows": rows}})
    # 40 ms, and 360 by 4 and by 8 cores.
    assert "would take 130 and 85 ms" in note
    assert "2 cores: 4.00, 5.00 predictions a second; 2 times one core: 4.00." in of_callers

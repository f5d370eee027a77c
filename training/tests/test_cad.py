"""STEP files: their unit, their shape, and what cannot be read."""

import importlib.util
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from mvtop_train import run
from mvtop_train.data import limits, meshfile
from mvtop_train.errors import UserError
from mvtop_train.synthesis import cad

PIN = Path(__file__).with_name("files") / "pin.step"  # radius 10, length 30, from z = 0
STATED = "SI_UNIT(.MILLI.,.METRE.)"
WITHOUT_READER = importlib.util.find_spec("cascadio") is None
reader = pytest.mark.skipif(WITHOUT_READER, reason="needs the extra `step`")


def pin(folder: Path, unit: str | None) -> Path:
    """The pin with its numbers in another unit, or in none that is stated."""
    text = PIN.read_text()
    assert STATED in text
    if unit is None:
        text = text.replace("GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT((#15))", "")
        text = text.replace("GLOBAL_UNIT_ASSIGNED_CONTEXT((#12,#13,#14))", "")
        text = re.sub(r"^#1[2345]=.*\n", "", text, flags=re.MULTILINE)
    else:
        text = text.replace(STATED, f"SI_UNIT({unit},.METRE.)")
    path = folder / "pin.STP"
    path.write_text(text)
    return path


@reader
@pytest.mark.parametrize(
    ("stated", "asked", "size"),
    [(".MILLI.", None, 0.03), (".CENTI.", None, 0.3), (".MILLI.", "m", 0.03)]
    + [(None, "mm", 0.03), (None, "cm", 0.3)],
)
def test_a_step_file_has_its_shape_in_metres(stated, asked, size, tmp_path):
    cad.to_mesh(pin(tmp_path, stated), asked, tmp_path / "cad/pin.glb")
    mesh = meshfile.load_mesh(tmp_path / "cad/pin.glb", "m")
    assert np.allclose(mesh.bounds[:, 2], [0, size], atol=1e-6)
    assert np.allclose(mesh.extents[:2], size / 1.5, rtol=2 * cad.CHORD)
    assert mesh.volume == pytest.approx(np.pi * size**3 / 9, rel=0.01)
    assert len(mesh.faces) < 1000
    assert [path.name for path in (tmp_path / "cad").iterdir()] == ["pin.glb"]


@reader
@pytest.mark.parametrize("text", ["hello", PIN.read_text()[:2000]])
def test_what_is_no_step_file_is_one_sentence(text, tmp_path):
    (tmp_path / "pin.step").write_text(text)
    with pytest.raises(UserError, match="pin.step: expected a STEP file with .*; fix: "):
        cad.to_mesh(tmp_path / "pin.step", "mm", tmp_path / "pin.glb")
    assert not (tmp_path / "pin.glb").exists()


# Writes what is no mesh, after it asked for memory.
GREEDY = """
def step_to_glb(source, target, **_):
    bytearray({bytes})
    open(target, "w").write("made")
"""


@pytest.mark.skipif(not limits.STATUS.exists(), reason="only Linux bounds memory")
@pytest.mark.parametrize("more", [0, meshfile.MESH_MEMORY])
def test_the_reader_of_step_files_has_the_memory_of_other_meshes(more, tmp_path, monkeypatch):
    (tmp_path / "cascadio.py").write_text(GREEDY.format(bytes=2 * more))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: True)
    if more:
        with pytest.raises(UserError, match="pin.step: .* within 3 GiB of memory; fix: "):
            cad.to_mesh(PIN, None, tmp_path / "pin.glb")
    else:
        cad.to_mesh(PIN, None, tmp_path / "pin.glb")
        assert (tmp_path / "pin.glb").read_text() == "made"


def test_without_the_reader_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(UserError, match=r"none installed; fix: pip install 'mvtop-train\[step\]'"):
        cad.to_mesh(PIN, None, tmp_path / "pin.glb")


@reader
def test_a_file_without_a_unit_asks_for_it(tmp_path):
    with pytest.raises(UserError, match=r"pin.STP: expected a unit .*; fix: --mesh-unit \(m, cm"):
        cad.to_mesh(pin(tmp_path, None), None, tmp_path / "pin.glb")


def test_a_file_that_is_not_there_is_one_sentence(tmp_path):
    with pytest.raises(UserError, match="none.step: expected a file .*; fix: "):
        cad.to_mesh(tmp_path / "none.step", None, tmp_path / "pin.glb")


@reader
def test_scenes_of_a_step_file_need_no_unit(tmp_path):
    command = [sys.executable, "-m", "mvtop_train.generate", "--mesh", str(PIN), "--out"]
    command += [str(tmp_path), "--rig", "three", "--scenes", "1", "--workers", "1"]
    subprocess.run(command, check=True)
    (info,) = json.loads((tmp_path / "models/models_info.json").read_text()).values()
    assert info["name"] == "pin" and info["size_z"] == pytest.approx(30)
    assert (tmp_path / "train/000000/scene_gt.json").is_file()


@pytest.mark.parametrize(("mesh", "asked"), [("a.stl", True), ("a.step", False)])
def test_a_run_asks_for_the_unit_of_other_meshes_alone(mesh, asked, monkeypatch, tmp_path):
    started = []
    monkeypatch.setattr(run.pipeline, "run", lambda *of: started.append(of))
    rig = str(Path(run.__file__).with_name("runs") / "three.rig.json")
    options = ["--mesh", mesh, "--rig", rig, "--out", str(tmp_path), "--minutes", "9"]
    monkeypatch.setattr(sys, "argv", ["run", *options])
    if asked:
        with pytest.raises(SystemExit, match="--mesh-unit: expected with --mesh, got none"):
            run.main()
    else:
        run.main()
        (settings, _, _) = started[0]
        assert settings.generate.mesh == (mesh,) and settings.generate.mesh_unit == ""

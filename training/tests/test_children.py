"""Processes that a command starts run nothing of the current folder."""

import ast
import multiprocessing
import os
import subprocess
import sys
from pathlib import Path

import pytest

import mvtop_train
from mvtop_train import children

PACKAGE = Path(mvtop_train.__file__).parent
PIN = Path(__file__).with_name("files") / "pin.step"
# Modules that children import first, and one that a STEP file needs.
TAKEN = ("cascadio", "json", "pickle", "signal", "subprocess", "multiprocessing", "numpy")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current folder: each module there says that it was run."""
    for name in TAKEN:
        ran = f"open({str(tmp_path / 'ran')!r}, 'a').write({name!r})\n"
        (tmp_path / f"{name}.py").write_text(ran)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_python_takes_no_module_of_the_current_folder(folder):
    code = "import json, numpy, mvtop_train; assert json.dumps([1]) == '[1]'"
    subprocess.run(children.python("-c", code), check=True)
    subprocess.run([sys.executable, "-c", code], check=True)  # by the environment alone
    assert not (folder / "ran").exists()


def test_spawned_workers_take_no_module_of_the_current_folder(folder):
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert pool.apply(os.getpid) != os.getpid()
    assert not (folder / "ran").exists()


def test_a_command_with_all_its_processes_takes_none(folder):
    start = "import sys; from mvtop_train import generate; generate.main()"
    options = ["--mesh", str(PIN), "--out", "out", "--scenes", "1", "--workers", "1", "--rig"]
    command = [sys.executable, "-P", "-c", start, *options, "three"]  # as the console script
    told = subprocess.run(command, capture_output=True, text=True, check=False)
    assert not (folder / "ran").exists(), (folder / "ran").read_text()
    assert told.returncode == 0 or "none installed" in told.stderr, told.stderr


def test_every_python_is_started_by_the_one_helper():
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.List) and path.name != "children.py":
                elements = map(ast.unparse, node.elts)
                assert "sys.executable" not in elements, f"{path}:{node.lineno}"


@pytest.mark.parametrize("way", ["absolute", "relative", "current folder"])
def test_children_find_the_package_where_their_parent_found_it(way, tmp_path):
    (tmp_path / "below").mkdir()
    (tmp_path / "below/mvtop_train").symlink_to(PACKAGE)
    entry = {"absolute": str(tmp_path / "below"), "relative": "below", "current folder": ""}[way]
    variables = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONSAFEPATH")}
    variables |= {"PYTHONPATH": entry} if entry else {}
    child = "import mvtop_train; print(mvtop_train.__file__)"
    code = "import subprocess; from mvtop_train import children; "
    code += f"subprocess.run(children.python('-c', {child!r}), check=True, cwd='/')"
    where = tmp_path if entry else tmp_path / "below"
    # Without what is installed: of an installed package children are certain.
    done = subprocess.run(
        [sys.executable, "-S", "-c", code], env=variables, cwd=where, capture_output=True, text=True
    )
    assert done.returncode == 0 and done.stdout.endswith("mvtop_train/__init__.py\n"), done.stderr

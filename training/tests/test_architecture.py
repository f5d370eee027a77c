"""Which package may use which: read from the imports, so that a new arrow is a decision."""

import ast
import graphlib
import subprocess
import sys
from pathlib import Path

import mvtop_train

ROOT = Path(mvtop_train.__file__).parent
# What each package may import; any module may import those of `BASE`.
ALLOWED = {
    "network": set(),
    "data": {"network"},
    "synthesis": {"data"},
    "training": {"network", "data", "evaluation"},
    "export": {"network", "data", "training"},
    "study": {"network", "data", "training", "evaluation"},
    "evaluation": {"network", "data"},
    "adapt": {"network", "data", "training", "evaluation", "export"},
}
COMMANDS = {"calibrate", "cli", "generate", "train", "run"}  # beside `export` and `adapt`
BASE = {"children", "errors", "files", "description", "shipped"}


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_name(path): path for path in sorted(ROOT.rglob("*.py"))}


def imported(name: str, path: Path) -> set[str]:
    """Modules of the project that a module imports anywhere, those within functions included."""
    package = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
            found |= {n.removeprefix("mvtop_train.") for n in names if n.startswith("mvtop_train.")}
        elif isinstance(node, ast.ImportFrom):
            base = (node.module or "").split(".") if node.module else []
            if node.level:
                base = package[: len(package) - node.level + 1] + base
            elif base[0] != "mvtop_train":
                continue
            else:
                base = base[1:]
            for alias in node.names:
                whole = ".".join([*base, alias.name])
                found.add(whole if whole in MODULES else ".".join(base))
    return found - {name}


ARROWS = {name: imported(name, path) for name, path in MODULES.items()}


def package_of(name: str) -> str:
    return name.split(".")[0]


def packages() -> dict[str, set[str]]:
    """Package -> packages that its modules import."""
    found = {}
    for name, targets in ARROWS.items():
        used = found.setdefault(package_of(name), set())
        used |= {package_of(target) for target in targets} - {package_of(name)}
    return found


def test_every_module_has_its_package():
    assert {package_of(name) for name in MODULES if name} == ALLOWED.keys() | COMMANDS | BASE
    assert len(MODULES) > 40 and sum(map(len, ARROWS.values())) > 80  # the reader sees them


def test_packages_use_only_what_they_may():
    found = packages()
    for package, allowed in ALLOWED.items():
        assert found[package] - BASE <= allowed, package
    for base in BASE:
        assert found[base] <= BASE
    for command in COMMANDS:  # nothing imports a command
        assert not any(command in targets for targets in found.values()), command
    # Exporting reads weights; it knows nothing else of how they came about.
    used = {t for name, targets in ARROWS.items() if package_of(name) == "export" for t in targets}
    assert {t for t in used if package_of(t) == "training"} == {"training.checkpoint"}


def test_the_packages_hang_together_by_few_arrows():
    arrows = {(a, b) for a, targets in packages().items() if a in ALLOWED for b in targets - BASE}
    print(f"{len(arrows)} arrows between packages: {sorted(arrows)}")
    assert len(arrows) == sum(map(len, ALLOWED.values())), "an arrow of ALLOWED is not used"


def test_no_module_is_on_a_circle():
    list(graphlib.TopologicalSorter(ARROWS).static_order())  # raises CycleError
    list(graphlib.TopologicalSorter(packages()).static_order())


def python(code: str) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)


def test_imports_neither_load_the_kernel_nor_end_the_interpreter():
    names = [f"mvtop_train.{name}" for name in MODULES if name]
    code = "import importlib, pathlib\n"
    code += f"for name in {names}: importlib.import_module(name)\n"
    code += "assert '_mvtop' not in pathlib.Path('/proc/self/maps').read_text(), 'kernel loaded'"
    done = python(code + "\nprint('alive')")
    assert done.returncode == 0 and done.stdout.endswith("alive\n"), done.stdout + done.stderr


def test_the_generator_knows_neither_torch_nor_opengl_when_it_starts():
    """Software GL and PyTorch each bring an LLVM; where OpenGL is missing, a sentence says so."""
    done = python("import sys, mvtop_train.generate; print({'torch', 'mujoco'} & set(sys.modules))")
    assert done.stdout == "set()\n", done.stdout + done.stderr


def test_only_commands_end_the_process():
    """Library code raises `UserError`, which a caller can catch."""
    for name, path in MODULES.items():
        if name in COMMANDS | BASE:
            continue
        ends = {"SystemExit", "sys.exit", "os._exit", "exit", "quit"}
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Name | ast.Attribute):
                assert ast.unparse(node) not in ends, f"{path}:{node.lineno}"


def test_every_command_says_what_is_wrong_in_one_line():
    """`main` is decorated with `errors.command` wherever a module can be run."""
    runnable = 0
    for path in MODULES.values():
        tree = ast.parse(path.read_text())
        mains = [n for n in tree.body if isinstance(n, ast.FunctionDef) and n.name == "main"]
        for main in mains:
            runnable += 1
            assert "command" in [ast.unparse(d) for d in main.decorator_list], path
    assert runnable >= 12

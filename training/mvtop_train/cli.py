"""The command `mvtop-train`: each of its commands is a module that runs by itself as well.

A module is imported when it is asked for: PyTorch takes seconds.
"""

import importlib
import sys
from dataclasses import dataclass

from . import shipped
from .errors import UserError, command

PROGRAM = "mvtop-train"


@dataclass(frozen=True)
class Command:
    """A command: the module of `mvtop_train` whose `main` it calls, and a line for `--help`."""

    module: str
    about: str


COMMANDS = {
    "run": Command("run", "meshes or a config to a trained, exported, evaluated model"),
    "adapt": Command("adapt.__main__", "adapt a model to your cell from unlabelled photographs"),
    "generate": Command("generate", "render scenes in BOP layout"),
    "train": Command("train", "train a network on scenes that are there"),
    "export": Command("export.__main__", "write trained weights as a bundle"),
    "calibrate": Command("calibrate", "fit the confidences of a bundle on held-out scenes"),
    "restore": Command("export.restore", "read weights back from a bundle"),
    "mesh": Command("export.mesh", "add the meshes for refinement to a bundle"),
    "catalogue": Command("synthesis.catalogue", "write example parts with their symmetries"),
    "samples": Command("synthesis.samples", "render held-out samples of MV-ball"),
    "coordinates": Command("synthesis.coordinates", "add object coordinates to a data set"),
    "detector": Command("evaluation.detector", "measure the boxes of single images"),
    "dataset-report": Command("evaluation.dataset_report", "draw a contact sheet of scenes"),
    "reliability": Command("evaluation.reliability", "how often confident poses are right"),
    "accuracy": Command("evaluation.accuracy", "measure, show and compare accuracy on fixed sets"),
    "lies": Command("evaluation.lies", "measure how many wrong rigs and images are noticed"),
}
LIST = "list"  # of what is shipped


def usage() -> str:
    about = {name: known.about for name, known in COMMANDS.items()}
    about[LIST] = "print the run configs and rigs that come along"
    width = max(map(len, about))
    return "\n".join([
        f"usage: {PROGRAM} COMMAND [OPTIONS]    ({PROGRAM} COMMAND --help for its options)",
        "",
        "Trains the networks that mvtop runs.",
        "",
        "commands:",
        *(f"  {name:{width}}  {line}" for name, line in about.items()),
        "",
        "example:",
        f"  {PROGRAM} run --mesh part.obj --mesh-unit mm --rig rig.json --minutes 60 --out runs/a",
    ])  # fmt: skip


def listing() -> str:
    """The names that `--config` and `--rig` take, and where the files are."""
    return "\n".join([
        f"--config: {', '.join(shipped.names(shipped.CONFIG))}",
        f"--rig: {', '.join(shipped.names(shipped.RIG))}",
        f"files: {shipped.FOLDER}",
    ])  # fmt: skip


@command
def main():
    name, *rest = sys.argv[1:] or ["--help"]
    if name in ("-h", "--help", "help"):
        print(usage())
    elif name == "--version":
        from importlib.metadata import version

        print(PROGRAM, version(PROGRAM))
    elif name == LIST:
        print(listing())
    elif name in COMMANDS:
        sys.argv = [f"{PROGRAM} {name}", *rest]  # argparse takes its name from here
        importlib.import_module(f"mvtop_train.{COMMANDS[name].module}").main()
    else:
        raise UserError(
            f"{PROGRAM}: expected one of {', '.join([*COMMANDS, LIST])}, got {name!r}; "
            f"fix: {PROGRAM} --help"
        )


if __name__ == "__main__":
    main()

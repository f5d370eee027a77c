"""The commands `mvtop-cli rig calibrate`, `rig board` and `rig hand-eye`."""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mvtop._mvtop import Rig
from mvtop._printable import harmless, printable, refused
from mvtop.calibration import _need
from mvtop.calibration.lengths import metres
from mvtop.calibration.lenses import KINDS

WIDTH = 100
PROGRESS_STEP = 25
"""Images between two lines about how far detection is."""


def main(arguments: Sequence[str]) -> int:
    """Runs the command that `arguments` begin with; returns the exit code."""
    try:
        parsed = _parser().parse_args(list(arguments))
        _need.opencv(), _need.optimize()
        parsed.run(parsed)
    except BrokenPipeError:
        return 0
    except (ValueError, OSError, ModuleNotFoundError) as error:
        print(f"error: {printable(error)}", file=sys.stderr)
        return 2
    return 0


def say(text: str) -> None:
    """Prints lines, harmless whatever names of files and cameras are in them."""
    print(harmless(text))


class _Lines(argparse.RawDescriptionHelpFormatter):
    """Keeps lines of examples, and is as wide as the other commands' help."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, width=WIDTH)


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one sentence; its help has the words of the other commands'."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **(options | {"add_help": False}))
        self._optionals.title, self._positionals.title = "Options", "Arguments"
        self.add_argument("-h", "--help", action="help", help="Print help")

    def error(self, message: str) -> None:  # type: ignore[override]
        print(f"error: {printable(message)}; see {self.prog} --help", file=sys.stderr)
        raise SystemExit(2)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="mvtop-cli rig")
    commands = parser.add_subparsers(required=True, parser_class=_Parser)
    _calibrate(
        commands.add_parser(
            "calibrate",
            formatter_class=_Lines,
            description="Make a rig file from images of a board, all cameras at once.",
            epilog="""Examples:
  A folder for each exposure, with an image of each camera:
    mvtop-cli rig calibrate --board board.json shots/ -o rig.json --page verdict.html
  A wide lens, and the print measured from edge to edge:
    mvtop-cli rig calibrate --board board.json shots/ --lens top=fisheye --measured 269.4mm \\
        -o rig.json""",
        )
    )
    _board(
        commands.add_parser(
            "board",
            formatter_class=_Lines,
            description="Print a board, and write the file that says what was printed.",
            epilog="""Examples:
    mvtop-cli rig board --kind charuco --columns 9 --rows 6 --square 30mm -o board.pdf
    mvtop-cli rig board --kind aprilgrid --columns 6 --rows 6 --tag 40mm --paper a3 -o board.svg
    mvtop-cli rig board --from board.json -o board.pdf""",
        )
    )
    from mvtop.calibration import hand_eye_command

    hand_eye_command.add(commands, _Lines)
    return parser


def _calibrate(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add(
        "folders",
        nargs="+",
        type=Path,
        metavar="FOLDER",
        help="images as EXPOSURE/CAMERA.png, "
        "CAMERA/EXPOSURE.png or CAMERA_NUMBER.png; a scene of BOP; or a folder for each camera",
    )
    add(
        "--board",
        required=True,
        type=Path,
        metavar="FILE",
        help="board file, or Kalibr's target file",
    )
    add("-o", "--out", required=True, type=Path, metavar="FILE", help="rig file to write")
    add(
        "--lens",
        action="append",
        default=[],
        metavar="[ID=]LENS",
        help=f"of all cameras, or of one: {', '.join(KINDS)} [default: pinhole, of 5 coefficients]",
    )
    add("--intrinsics", type=Path, metavar="RIG", help="rig file whose cameras' lenses are kept")
    add("--cameras", type=_names, metavar="ID,...", help="these cameras alone")
    add("--reference", metavar="ID", help="the rig's reference camera [default: the first]")
    add(
        "--world",
        metavar="EXPOSURE",
        help="the board of this exposure is the world frame "
        "[default: the reference camera's frame is]",
    )
    add(
        "--layout",
        choices=["exposure/camera", "camera/exposure", "flat"],
        help="what folders and names are [default: recognised]",
    )
    add(
        "--measured",
        type=_length,
        metavar="LENGTH",
        help="a side of the pattern or of a square on the "
        "print, as 269.4mm: replaces the board file's",
    )
    add("--page", type=Path, metavar="FILE", help="write the verdict with pictures, HTML")
    add("--json", type=Path, metavar="FILE", help="write the verdict for programs")
    add("--no-hold-out", action="store_true", help="do not hold out exposures: faster, no verdict")
    add(
        "--trust-unit", action="store_true", help="cameras do stand that near together or far apart"
    )
    add("--force", action="store_true", help="overwrite files that exist")
    parser.set_defaults(run=_run_calibrate)


def _run_calibrate(args: argparse.Namespace) -> None:
    from mvtop.calibration import calibrate

    outputs = [path for path in (args.out, args.page, args.json) if path is not None]
    read = [args.board] + ([args.intrinsics] if args.intrinsics else [])
    for path in outputs:
        may_write(path, args.force, read)
    result = calibrate(
        args.folders,
        args.board,
        lens=_lenses(args.lens),
        intrinsics=args.intrinsics,
        cameras=args.cameras,
        reference=args.reference,
        world=args.world,
        layout=args.layout,
        measured=args.measured,
        hold_out=not args.no_hold_out,
        trust_unit=args.trust_unit,
        progress=_progress,
    )
    say(result.text())
    write(args.out, result.rig.to_json())
    if args.page is not None:
        write(args.page, result.page())
    if args.json is not None:
        write(args.json, json.dumps(result.to_dict(), indent=1) + "\n")
    say(f"{args.out}: written; look at it: mvtop-cli rig show {args.out} --picture rig.svg")


def _progress(done: int, total: int) -> None:
    if total >= 2 * PROGRESS_STEP and done % PROGRESS_STEP == 0:
        print(f"{done} of {total} images searched", file=sys.stderr)


def _lenses(given: Sequence[str]) -> str | dict[str, str]:
    by_camera, of_all = {}, "pinhole"
    for text in given:
        camera, sign, lens = text.rpartition("=")
        if sign:
            by_camera[camera] = lens
        else:
            of_all = lens
    return _Default(by_camera, of_all) if by_camera else of_all


class _Default(dict[str, str]):
    """Lenses by camera; of others, `of_all`."""

    def __init__(self, by_camera: dict[str, str], of_all: str) -> None:
        super().__init__(by_camera)
        self.of_all = of_all


def _board(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--kind", choices=["charuco", "chessboard", "aprilgrid"])
    add("--from", dest="source", type=Path, metavar="FILE", help="print what a board file says")
    add("--columns", type=int, metavar="N", help="squares, or tags, in a row")
    add("--rows", type=int, metavar="N")
    add("--square", type=_length, metavar="LENGTH", help="side of a square, as 30mm")
    add(
        "--marker",
        type=_length,
        metavar="LENGTH",
        help="side of a marker [default: 3/4 of a square]",
    )
    add("--tag", type=_length, metavar="LENGTH", help="side of a tag")
    add("--gap", type=_length, metavar="LENGTH", help="between tags [default: 3/10 of a tag]")
    add(
        "--dictionary",
        metavar="NAME",
        help="OpenCV's, or tag36h11 and others of AprilTag [default: 5X5_1000, tag36h11]",
    )
    add("--first-id", type=int, default=0, metavar="N", help="number of the first marker")
    add(
        "--paper",
        metavar="SIZE",
        help="a4, a3, a2, a1, a0 or letter [default: the smallest that fits]",
    )
    add(
        "-o",
        "--out",
        required=True,
        type=Path,
        metavar="FILE",
        help="PDF or SVG to write; the board file is written beside it, as .json",
    )
    add("--force", action="store_true", help="overwrite files that exist")
    parser.set_defaults(run=_run_board)


def _run_board(args: argparse.Namespace) -> None:
    from mvtop.calibration import Board, printing

    ending = args.out.suffix.lower()
    if ending not in (".pdf", ".svg"):
        raise refused(f"{args.out}: expected a name that ends in .pdf or .svg")
    beside = args.out.with_suffix(".json")
    board = Board.load(args.source) if args.source else Board.from_dict(_wanted_board(args))
    if args.paper is not None and args.paper.lower() not in printing.PAPERS:
        raise refused(f"--paper: expected one of {', '.join(printing.PAPERS)}, got {args.paper}")
    paper = printing.paper_of(board, args.paper and args.paper.lower())
    own = args.source is not None and args.source.resolve() == beside.resolve()
    read = [args.source] if args.source else []
    may_write(args.out, args.force, read)
    if not own:
        may_write(beside, args.force, read)
        write(beside, json.dumps(board.to_dict(), indent=1) + "\n")
    if ending == ".svg":
        write(args.out, printing.svg(board, paper))
    else:
        write(args.out, printing.pdf(board, paper))
    say(f"{args.out}: {paper[0]:.0f} x {paper[1]:.0f} mm; {printing.caption(board)}")
    say(f"{beside}: the board file, for mvtop-cli rig calibrate --board {beside}")


def _wanted_board(args: argparse.Namespace) -> dict[str, object]:
    if args.kind is None:
        raise ValueError(
            "--kind: expected charuco, chessboard or aprilgrid, or a board file with --from"
        )
    needed = ["columns", "rows", "tag" if args.kind == "aprilgrid" else "square"]
    for name in needed:
        if getattr(args, name) is None:
            raise refused(f"--{name} is missing, which a {args.kind} needs")
    values: dict[str, object] = {"format": "mvtop-board", "version": 1, "unit": "mm"}
    values |= {"kind": args.kind, "columns": args.columns, "rows": args.rows}
    if args.kind == "aprilgrid":
        gap = 0.3 * args.tag if args.gap is None else args.gap
        values |= {"tag": round(1e3 * args.tag, 6), "gap": round(1e3 * gap, 6)}
        values |= {"dictionary": args.dictionary or "tag36h11", "first_id": args.first_id}
        return values
    values["square"] = round(1e3 * args.square, 6)
    if args.kind == "charuco":
        marker = 0.75 * args.square if args.marker is None else args.marker
        values |= {"marker": round(1e3 * marker, 6), "first_id": args.first_id}
        values["dictionary"] = args.dictionary or "5X5_1000"
    return values


def _names(text: str) -> list[str]:
    return [name for name in text.split(",") if name]


def _length(text: str) -> float:
    try:
        return metres(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def may_write(path: Path, force: bool, read: Sequence[Path] = ()) -> None:
    """Refuses to overwrite a file unless `force`, and one that is read in any case.

    Raises FileExistsError.
    """
    if not (path.exists() or path.is_symlink()):
        return
    if path.is_dir() or not (path.is_file() or path.is_symlink()):
        raise FileExistsError(f"{path} is a folder or a device, expected a file; name another one")
    if any(other.exists() and other.samefile(path) for other in read if path.exists()):
        raise FileExistsError(f"{path} is one of the files that are read; name another file")
    if not force:
        raise FileExistsError(f"{path} exists already; give --force to overwrite it")


def write(path: Path, contents: str | bytes) -> None:
    """The file appears when it is whole."""
    data = contents.encode() if isinstance(contents, str) else contents
    try:
        with tempfile.NamedTemporaryFile(dir=path.parent, prefix=".mvtop-", delete=False) as file:
            file.write(data)
        mask = os.umask(0)
        os.umask(mask)
        os.chmod(file.name, 0o666 & ~mask)
        os.replace(file.name, path)
    except OSError as cause:
        raise OSError(printable(f"cannot write {path}: {cause.strerror}")) from None


def save_rig(path: Path, rig: Rig) -> None:
    """Writes a rig file, which is read back before."""
    write(path, Rig.from_json(rig.to_json()).to_json())

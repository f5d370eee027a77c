"""`mvtop-cli rig hand-eye`."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mvtop._mvtop import Rig
from mvtop._printable import refused
from mvtop.calibration.robot_poses import DIRECTIONS, ROTATIONS, UNITS

if TYPE_CHECKING:
    from mvtop.calibration.on_robot import RobotRig

EXAMPLES = """Examples:
  A board in view of a rig, a set of images and a line of poses.csv for each pose of the robot:
    mvtop-cli rig hand-eye shots/ --rig rig.json --board board.json --robot-poses poses.csv \\
        --eye base -o on_robot.json
  A camera on the hand, which is then moved to three poses, as one rig of three cameras:
    mvtop-cli rig hand-eye --rig on_robot.json --robot-poses views.csv --rotation xyzw \\
        --direction base_from_hand --unit m -o views.json"""


def add(commands: Any, formatter: Any) -> None:
    """Adds the command to the parser's."""
    parser = commands.add_parser(
        "hand-eye",
        formatter_class=formatter,
        description="Bring a rig into the robot's frames: cameras on its hand, or that stand. "
        "\nWithout images, a rig on the hand and poses of the hand give a camera for each pose.",
        epilog=EXAMPLES,
    )
    add = parser.add_argument
    add(
        "folders",
        nargs="*",
        type=Path,
        metavar="FOLDER",
        help="images, as of `rig calibrate`; exposures are named as poses are",
    )
    add("--rig", required=True, type=Path, metavar="RIG", help="rig file of the cameras")
    add("--board", type=Path, metavar="FILE", help="board file")
    add(
        "--robot-poses",
        required=True,
        type=Path,
        metavar="FILE",
        help="poses of the hand: CSV, JSON, or what ROS prints",
    )
    add("-o", "--out", required=True, type=Path, metavar="FILE", help="rig file to write")
    add(
        "--eye",
        choices=["hand", "base"],
        help="cameras move with the hand, or stand as the base does "
        "[default: found, where --direction is given]",
    )
    add("--rotation", choices=sorted(ROTATIONS), help="what a pose's rotation is [default: found]")
    add(
        "--direction",
        choices=DIRECTIONS,
        help="what a pose maps to what [default: found, where --eye is given]",
    )
    add("--unit", choices=sorted(UNITS), help="of places [default: found]")
    add("--layout", choices=["exposure/camera", "camera/exposure", "flat"])
    add("--json", type=Path, metavar="FILE", help="write residuals and standard deviations")
    add("--force", action="store_true", help="overwrite files that exist")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> None:
    """Does what the arguments say."""
    from mvtop.calibration import on_robot, robot_poses
    from mvtop.calibration.commands import may_write, save_rig, say, write

    read = [p for p in (args.rig, args.board, args.robot_poses) if p is not None]
    for path in (args.out, args.json):
        if path is not None:
            may_write(path, args.force, read)
    if not args.folders:
        rig = Rig.load(args.rig)
        poses = robot_poses.load(args.robot_poses)
        reading = _said(args, poses)
        made = on_robot.at_poses(rig, poses, **reading)
        save_rig(args.out, made)
        count = len(poses.numbers)
        say(f"{args.out}: {len(made)} cameras, of {count} poses of the hand; its world is the base")
        return
    if args.board is None:
        raise ValueError("--board is missing: images show a board that its file describes")
    told = on_robot.calibrate_hand_eye(
        args.rig,
        args.folders,
        args.board,
        args.robot_poses,
        eye=args.eye,
        rotation=args.rotation,
        direction=args.direction,
        unit=args.unit,
        layout=args.layout,
    )
    say(text(told))
    save_rig(args.out, told.rig)
    if args.json is not None:
        write(args.json, json.dumps(to_dict(told), indent=1) + "\n")
    world = "the robot's hand" if told.result.eye == "hand" else "the robot's base"
    say(f"{args.out}: written; its world is {world}")


def _said(args: argparse.Namespace, poses: Any) -> dict[str, str]:
    """The reading of poses that nothing is compared with: of the file, or asked for."""
    left = poses.readings(args.rotation, args.direction, args.unit)
    told = {
        "rotation": args.rotation or poses.rotation,
        "direction": args.direction or poses.direction,
        "unit": args.unit or poses.unit,
    }
    for (name, value), known in zip(told.items(), left, strict=True):
        if value is None:
            raise refused(
                f"--{name} is missing: without images nothing tells how {args.robot_poses} is "
                f"to be read; fix: --{name} {' or '.join(known)}"
            )
    return told


def text(told: RobotRig) -> str:
    """Lines for people."""
    result = told.result
    how = "found by which reading is consistent" if result.found else "as said"
    lines = [f"reading ({how}): {result.reading()}"]
    if result.next_best:
        lines.append(f"  the next best, {result.next_best}")
    used = [r for r in result.residuals if r.used]
    lines.append("exposure  turn, degrees  shift, mm")
    for residual in result.residuals:
        mark = "" if residual.used else "  left out: speaks against the other poses"
        lines.append(
            f"{residual.exposure:>8}  {residual.turn_deg:13.3f}  {residual.shift_mm:9.2f}{mark}"
        )
    turn, shift = np.median([[r.turn_deg, r.shift_mm] for r in used], axis=0)
    lines.append(
        f"{len(used)} poses: {turn:.3f} degrees and {shift:.2f} mm, median; the rig's place is "
        f"known to "
        f"{result.turn_sd_deg:.3f} degrees and {result.shift_sd_mm:.2f} mm (standard deviations)"
    )
    if bad := [r.exposure for r in result.residuals if not r.used]:
        names = ", ".join(f"`{name}`" for name in bad)
        lines.append(f"warning: {names} left out: the pose is another one's, or the board slipped")
    lines += [f"warning: {warning}" for warning in told.warnings]
    return "\n".join(lines)


def to_dict(told: RobotRig) -> dict[str, Any]:
    """Everything for programs."""
    result = told.result
    world, board = ("hand", "base") if result.eye == "hand" else ("base", "hand")
    return {
        "format": "mvtop-hand-eye",
        "version": 1,
        "eye": result.eye,
        "rotation": result.rotation,
        "direction": result.direction,
        "unit": result.unit,
        f"T_{world}_ref": result.world_from_ref.tolist(),
        f"T_{board}_board": result.board_pose.tolist(),
        "turn_sd_deg": result.turn_sd_deg,
        "shift_sd_mm": result.shift_sd_mm,
        "poses": [vars(residual) for residual in result.residuals],
        "warnings": told.warnings,
    }

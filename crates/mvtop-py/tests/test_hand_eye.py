"""Rigs on robots, by poses of boards that are computed rather than seen."""

import json
from importlib.util import find_spec

import numpy as np
import pytest
from boards import Renderer, look_at

import mvtop
from mvtop.calibration import (
    Board,
    at_poses,
    calibrate_hand_eye,
    hand_eye,
    rigid,
    robot_poses,
)
from mvtop.calibration.commands import main

pytestmark = pytest.mark.skipif(
    not find_spec("scipy"), reason="the extra mvtop[calibrate] is not installed"
)


def pose(rng, turn, shift, at=(0.0, 0.0, 0.0)):
    return rigid.rigid(
        rigid.exponential(rng.normal(size=3) * turn), at + rng.normal(size=3) * shift
    )


@pytest.fixture
def cell(rng):
    """The truth: hand_from_ref or base_from_ref, and per exposure base_from_hand,
    ref_from_board."""

    def make(eye, count=12, noise_mm=0.1):
        world_from_ref = pose(rng, 0.8, 0.1)
        board = pose(rng, 0.5, 0.1, (0.6, 0.1, 0.1))
        hands, boards = {}, {}
        for i in range(count):
            hand = pose(rng, 0.5, 0.15, (0.4, 0.0, 0.5))
            moving = hand if eye == "hand" else rigid.inverse(hand)
            noise = pose(rng, 1e-4, 1e-3 * noise_mm)
            hands[f"p{i}"] = hand
            boards[f"p{i}"] = rigid.inverse(moving @ world_from_ref) @ board @ noise
        return world_from_ref, hands, boards

    return make


def table(hands, *, order="wxyz", direction="base_from_hand", unit=1.0, header=None):
    lines = [header] if header else []
    for name, hand in hands.items():
        hand = hand if direction == "base_from_hand" else rigid.inverse(hand)
        q = rigid.quaternion(hand[:3, :3])
        q = q if order == "wxyz" else np.roll(q, -1)
        lines.append(",".join([name, *(f"{v:.9f}" for v in [*(hand[:3, 3] / unit), *q])]))
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("eye", ["hand", "base"])
@pytest.mark.parametrize("order", ["wxyz", "xyzw"])
@pytest.mark.parametrize("direction", ["base_from_hand", "hand_from_base"])
def test_the_consistent_reading_is_found(cell, tmp_path, eye, order, direction):
    truth, hands, boards = cell(eye)
    path = tmp_path / "poses.csv"
    path.write_text(table(hands, order=order, direction=direction, unit=0.001))
    found = hand_eye.solve(boards, robot_poses.load(path), eye=eye)
    assert (found.eye, found.rotation, found.direction, found.unit) == (eye, order, direction, "mm")
    assert found.found and found.next_best
    off = rigid.inverse(found.world_from_ref) @ truth
    assert rigid.angle_deg(off[:3, :3]) < 0.05 and np.linalg.norm(off[:3, 3]) < 3e-4
    assert all(residual.used for residual in found.residuals)
    # As well as it says.
    assert np.linalg.norm(off[:3, 3]) < 5e-3 * found.shift_sd_mm


def test_a_bad_pose_is_named(cell, tmp_path):
    truth, hands, boards = cell("hand")
    hands["p4"] = rigid.rigid(rigid.exponential(np.array([0.05, 0, 0])), [0.01, 0, 0]) @ hands["p4"]
    path = tmp_path / "poses.csv"
    path.write_text(table(hands))
    found = hand_eye.solve(boards, robot_poses.load(path), unit="m", direction="base_from_hand")
    assert found.eye == "hand"
    assert [r.exposure for r in found.residuals if not r.used] == ["p4"]
    off = rigid.inverse(found.world_from_ref) @ truth
    assert rigid.angle_deg(off[:3, :3]) < 0.05 and np.linalg.norm(off[:3, 3]) < 3e-4


FORMS = {
    "json.json": lambda hands: json.dumps({k: v.tolist() for k, v in hands.items()}),
    "list.json": lambda hands: json.dumps(
        [{"name": k, "T_base_hand": v.tolist()} for k, v in hands.items()]
    ),
    "named.csv": lambda hands: table(hands, header="name,x,y,z,qw,qx,qy,qz"),
    "rotvec.csv": lambda hands: (
        "name,x_mm,y_mm,z_mm,rx,ry,rz\n"
        + "".join(
            ",".join([k, *(f"{n:.9f}" for n in [*(1e3 * v[:3, 3]), *rigid.logarithm(v[:3, :3])])])
            + "\n"
            for k, v in hands.items()
        )
    ),
    "ros.yaml": lambda hands: "---\n".join(
        f"name: {k}\npose:\n  position:\n"
        + "".join(f"    {a}: {n:.9f}\n" for a, n in zip("xyz", v[:3, 3], strict=True))
        + "  orientation:\n"
        + "".join(
            f"    {a}: {n:.9f}\n"
            for a, n in zip("xyzw", np.roll(rigid.quaternion(v[:3, :3]), -1), strict=True)
        )
        for k, v in hands.items()
    ),
}


@pytest.mark.parametrize("form", FORMS)
def test_poses_are_read_from(form, cell, tmp_path):
    truth, hands, boards = cell("base")
    path = tmp_path / form
    path.write_text(FORMS[form](hands))
    found = hand_eye.solve(boards, robot_poses.load(path), eye="base")
    off = rigid.inverse(found.world_from_ref) @ truth
    assert rigid.angle_deg(off[:3, :3]) < 0.05 and np.linalg.norm(off[:3, 3]) < 3e-4


def test_what_fixes_nothing_is_refused(cell, tmp_path, rng):
    _, hands, boards = cell("hand")
    path = tmp_path / "poses.csv"
    path.write_text(table(hands))
    poses = robot_poses.load(path)
    with pytest.raises(ValueError, match="say --eye hand or --eye base"):
        hand_eye.solve(boards, poses)
    with pytest.raises(ValueError, match="0 exposures have both a board and a robot pose"):
        hand_eye.solve({f"{k}x": v for k, v in boards.items()}, poses)
    still = {k: rigid.rigid(np.eye(3), v[:3, 3]) for k, v in hands.items()}
    path.write_text(table(still))
    with pytest.raises(ValueError, match="hardly turns"):
        hand_eye.solve(boards, robot_poses.load(path), eye="hand")
    for text, words in {
        "a,1,2,3,1,1,1,1\n": "length 1",
        "name,x,y,z,foo\na,1,2,3,4\n": "expected columns",
        "a,1,2,3\n": "7 or 6 numbers",
        '{"a": {"t": [1, 2, 3]}}': "expected a 4x4 matrix",
    }.items():
        path.write_text(text)
        with pytest.raises(ValueError, match=words):
            robot_poses.load(path)


def test_a_camera_at_several_poses_is_a_rig(cell, tmp_path):
    hand_from_cam, hands, _ = cell("hand", count=3)
    camera = mvtop.Camera(
        [[700, 0, 320], [0, 700, 240], [0, 0, 1]],
        (640, 480),
        world_from_cam=hand_from_cam,
        id="wrist",
    )
    path = tmp_path / "poses.csv"
    path.write_text(table(hands, order="xyzw"))
    poses = robot_poses.load(path)
    made = at_poses(
        mvtop.Rig([camera]), poses, rotation="xyzw", direction="base_from_hand", unit="m"
    )
    assert [c.id for c in made.cameras] == list(hands)
    for c in made.cameras:
        np.testing.assert_allclose(c.world_from_cam, hands[c.id] @ hand_from_cam, atol=1e-6)


def on_hand(count=8):
    """A camera on the hand, a board that lies still, and where the hand is for each exposure."""
    camera = mvtop.Camera([[700, 0, 320], [0, 700, 240], [0, 0, 1]], (640, 480), id="wrist")
    values = {"format": "mvtop-board", "version": 1, "unit": "mm", "kind": "charuco"}
    values |= {"columns": 7, "rows": 5, "square": 50, "marker": 38, "dictionary": "4X4_50"}
    board = Board.from_dict(values)
    rng = np.random.default_rng(4)
    hand_from_cam = rigid.rigid(rigid.exponential(np.array([0.1, -0.2, 1.5])), [0.03, -0.05, 0.08])
    base_from_board = rigid.rigid(rigid.exponential(np.array([0.0, np.pi, 0.3])), [0.7, 0.1, 0.02])
    middle = board.points.mean(axis=0)
    hands, ref_from_board = {}, {}
    for i in range(count):
        center = middle + rng.uniform(-1, 1, 3) * [0.3, 0.3, 0.1] + [0, 0, -0.6]
        board_from_cam = look_at(center, middle, float(rng.uniform(-60, 60)))
        hands[f"{i:02}"] = base_from_board @ board_from_cam @ rigid.inverse(hand_from_cam)
        ref_from_board[f"{i:02}"] = rigid.inverse(board_from_cam)
    return camera, board, values, hand_from_cam, hands, ref_from_board


def test_images_and_poses_give_the_hand(tmp_path, capsys):
    import cv2

    camera, board, values, hand_from_cam, hands, ref_from_board = on_hand()
    renderer = Renderer(board)
    (tmp_path / "shots").mkdir()
    for name, place in ref_from_board.items():
        path = tmp_path / f"shots/wrist_{name}.png"
        cv2.imwrite(str(path), renderer.render(camera, place))
    mvtop.Rig([camera]).save(tmp_path / "rig.json")
    (tmp_path / "board.json").write_text(json.dumps(values))
    (tmp_path / "poses.csv").write_text(table(hands, order="xyzw"))
    files = [f"--{n}={tmp_path / f}" for n, f in (("rig", "rig.json"), ("board", "board.json"))]
    poses = f"--robot-poses={tmp_path / 'poses.csv'}"
    out = tmp_path / "hand.json"
    typed = ["hand-eye", str(tmp_path / "shots"), *files, poses, "-o", str(out)]
    assert main(typed) == 2 and "say --eye hand or --eye base" in capsys.readouterr().err
    assert main([*typed, "--eye", "hand"]) == 0
    told = capsys.readouterr().out
    assert "rotations are xyzw, poses base_from_hand, in m" in told and "left out" not in told
    found = mvtop.Rig.load(out).cameras[0].world_from_cam
    off = rigid.inverse(found) @ hand_from_cam
    assert rigid.angle_deg(off[:3, :3]) < 0.1 and np.linalg.norm(off[:3, 3]) < 1e-3
    views = tmp_path / "views.json"
    typed = ["hand-eye", f"--rig={out}", poses, "-o", str(views)]
    assert main(typed) == 2 and "--rotation is missing" in capsys.readouterr().err
    said = ["--rotation=xyzw", "--direction=base_from_hand", "--unit=m"]
    assert main([*typed, *said]) == 0
    assert len(mvtop.Rig.load(views)) == len(hands)
    assert main([*typed, *said]) == 2 and "give --force" in capsys.readouterr().err


def test_images_of_another_size_are_refused():
    camera, board, _, _, hands, _ = on_hand(4)
    poses = robot_poses.RobotPoses("matrix", "matrix", None, "m", {})
    images = {"wrist": {"00": np.zeros((480, 480), np.uint8)}}
    with pytest.raises(ValueError, match="none of 1 images shows the charuco"):
        calibrate_hand_eye(mvtop.Rig([camera]), images, board, poses)
    with pytest.raises(ValueError, match="images of `other`: the rig's cameras are"):
        place = look_at([1, 0, 0], [1, 0, 1])
        other = mvtop.Camera(camera.K, camera.size, id="b", world_from_cam=place)
        calibrate_hand_eye(mvtop.Rig([camera, other]), {"other": images["wrist"]}, board, poses)

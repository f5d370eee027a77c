"""Rigs on robots, by poses of boards that are computed rather than seen."""

import json
from importlib.util import find_spec

import numpy as np
import pytest

import mvtop
from mvtop.calibration import at_poses, hand_eye, rigid, robot_poses

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

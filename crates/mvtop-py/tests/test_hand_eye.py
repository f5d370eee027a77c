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


TRUE = {"eye": "hand", "rotation": "xyzw", "direction": "base_from_hand", "unit": "m"}


@pytest.mark.parametrize("beside", [TRUE, {"eye": "hand"}])
@pytest.mark.parametrize(
    ("wrong", "fix"),
    [
        ({"rotation": "wxyz"}, "--rotation xyzw"),
        ({"direction": "hand_from_base"}, "--direction base_from_hand, or --eye base"),
        ({"unit": "cm"}, "--unit m"),
        ({"unit": "mm", "rotation": "wxyz"}, "--rotation xyzw and --unit m"),
        (
            {"eye": "base", "direction": "base_from_hand"},
            "--eye hand, or --direction hand_from_base",
        ),
    ],
)
def test_what_is_said_wrongly_is_refused_with_the_reading_that_fits(
    cell, tmp_path, beside, wrong, fix
):
    _, hands, boards = cell("hand")
    path = tmp_path / "poses.csv"
    path.write_text(table(hands, order="xyzw"))
    with pytest.raises(
        ValueError, match="expected hand, xyzw, base_from_hand, m, which f"
    ) as error:
        hand_eye.solve(boards, robot_poses.load(path), **(beside | wrong))
    assert str(error.value).endswith(f"; fix: {fix}")
    assert hand_eye.solve(boards, robot_poses.load(path), **(beside | TRUE)).rotation == "xyzw"


def test_named_columns_are_said_as_they_stand(cell, tmp_path):
    _, hands, boards = cell("hand")
    path = tmp_path / "poses.csv"
    path.write_text(table(hands, order="xyzw", header="name,x,y,z,qx,qy,qz,qw"))
    found = hand_eye.solve(boards, robot_poses.load(path), eye="hand", rotation="xyzw")
    assert found.rotation == "xyzw"
    with pytest.raises(ValueError, match="expected xyzw, as their file has it, got wxyz"):
        hand_eye.solve(boards, robot_poses.load(path), eye="hand", rotation="wxyz")


def test_what_a_file_says_wrongly_is_refused(cell, tmp_path):
    _, hands, boards = cell("hand")
    path = tmp_path / "poses.csv"
    path.write_text(table(hands, order="xyzw", header="name,x,y,z,qw,qx,qy,qz"))
    with pytest.raises(
        ValueError, match="got hand, wxyz, .* fix: rotation xyzw in the poses' file"
    ):
        hand_eye.solve(boards, robot_poses.load(path), eye="hand")
    turns = {
        k: {"t": v[:3, 3].tolist(), "rotvec": rigid.logarithm(v[:3, :3]).tolist()}
        for k, v in hands.items()
    }
    path.write_text(json.dumps(turns))
    with pytest.raises(ValueError, match="got one by which the hand hardly turns; fix: --rotation"):
        hand_eye.solve(boards, robot_poses.load(path), eye="hand", rotation="rotvec_deg")


@pytest.mark.parametrize("said", [TRUE, {"eye": "hand"}, {"eye": "hand", "unit": "mm"}])
def test_poses_of_other_exposures_fit_by_no_reading(cell, tmp_path, said):
    _, hands, boards = cell("hand")
    path = tmp_path / "poses.csv"
    path.write_text(table(dict(zip(hands, [*hands.values()][::-1], strict=True)), order="xyzw"))
    words = (
        r"no reading .* fits: expected at most 3 degrees and \d+ mm .* fix: give poses of the same"
    )
    with pytest.raises(ValueError, match=words):
        hand_eye.solve(boards, robot_poses.load(path), **said)


def test_readings_that_fit_alike_must_be_said(cell, tmp_path, rng):
    world_from_ref, hands, _ = cell("hand")
    board = pose(rng, 0.5, 0.1, (0.6, 0.1, 0.1))
    # The hand turns where it is, so that nothing tells the unit.
    hands = {k: rigid.rigid(v[:3, :3], np.zeros(3)) for k, v in hands.items()}
    boards = {k: rigid.inverse(hand @ world_from_ref) @ board for k, hand in hands.items()}
    path = tmp_path / "poses.csv"
    path.write_text(table(hands))
    poses = robot_poses.load(path)
    with pytest.raises(ValueError, match="two readings of the robot's poses fit alike"):
        hand_eye.solve(boards, poses, eye="hand", direction="base_from_hand", rotation="wxyz")
    said = {"eye": "hand", "direction": "base_from_hand", "rotation": "wxyz", "unit": "mm"}
    assert hand_eye.solve(boards, poses, **said).unit == "mm"


FORMS = {
    "json.json": lambda hands: json.dumps({k: v.tolist() for k, v in hands.items()}),
    "list.json": lambda hands: json.dumps(
        [{"name": k, "T_base_hand": v.tolist()} for k, v in hands.items()]
    ),
    "named.csv": lambda hands: table(hands, header="name,x,y,z,qw,qx,qy,qz"),
    "named_xyzw.csv": lambda hands: table(hands, order="xyzw", header="name,x,y,z,qx,qy,qz,qw"),
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


TURNED = [[0.0, -1, 0, 0.1], [1, 0, 0, 0.2], [0, 0, 1, 0.3], [0, 0, 0, 1]]
COLUMNS = np.transpose(TURNED).tolist()


def as_json(*poses, **said):
    return json.dumps(said | {"poses": [{"name": f"p{i}"} | pose for i, pose in enumerate(poses)]})


def by_matrix(change=(1, 1, 1), shear=0.0):
    rotation = np.diag(change) + shear * np.eye(3, k=1)
    return as_json({"T_base_hand": rigid.rigid(rotation, [0.1, 0.2, 0.3]).tolist()})


def by_turn(**turn):
    return as_json({"t": [0.1, 0.2, 0.3]} | turn)


def by_ros(*names, x="0.5", w="0.5", more=""):
    """A document for each name."""
    place = f"position:\n  x: {x}\n  y: 0.5\n  z: 0.5\n"
    turn = f"orientation:\n  x: 0.5\n  y: 0.5\n  z: 0.5\n  w: {w}\n"
    return "---\n".join(f"name: {name}\n{place}{turn}{more}" for name in names)


HAND, BASE, QUATERNION = {"T_base_hand": TURNED}, {"T_hand_base": TURNED}, {"q_wxyz": [1, 0, 0, 0]}
HEADER, ROW = "name,x,y,z,qw,qx,qy,qz", "a,1,2,3,1,0,0,0"
MISREAD = {
    "direction": (as_json(HAND, direction="world"), "base_from_hand or hand_from_base, got 'world"),
    "unit": (as_json(HAND, unit="ft"), "unit of poses: expected m or cm or mm, got 'ft'"),
    "both directions": (as_json(HAND, BASE), "got base_from_hand and hand_from_base; fix: give"),
    "one direction left open": (as_json(HAND, {"pose": TURNED}), "got base_from_hand and none"),
    "key against head": (as_json(HAND, direction="hand_from_base"), "and hand_from_base; fix"),
    "both in a pose": (as_json(HAND | BASE), "got the keys T_base_hand, T_hand_base"),
    "name twice": (as_json(HAND, HAND | {"name": "p0"}), "`p0`: expected each name once"),
    "key twice": ('{"a": [1, 2, 3, 1, 0, 0, 0], "a": [1, 2, 3, 1, 0, 0, 0]}', "`a`: expected each"),
    "head's key": (as_json(HAND, units="mm"), "expected format, .*, got `units`; fix"),
    "pose's key": (as_json(HAND | {"unit": "mm"}), "pose `p0`: .*, got `unit`; fix"),
    "two rotations": (by_turn(**QUATERNION, rpy=[0, 0, 1]), "got the keys t, q_wxyz, rpy"),
    "scaled": (by_matrix((2, 2, 2)), "off by 3.0e.00, determinant 8.0000; fix: take out scale"),
    "sheared": (by_matrix(shear=0.1), "determinant 1.0000; fix: take out scale and shear"),
    "mirrored": (by_matrix((1, 1, -1)), "a mirrored one, determinant -1.0000; fix"),
    "mirrored 3x3": (by_turn(R=np.diag([1, -1, 1]).tolist()), "got a mirrored one"),
    "last row": (as_json({"pose": [*TURNED[:3], [0, 0, 0, 2]]}), "got .0.0, 0.0, 0.0, 2.0"),
    "transposed": (as_json({"pose": COLUMNS}), "got a transposed one, .* fix: transpose it"),
    "NaN": (as_json({"pose": [*TURNED[:2], [0, 0, np.nan, 0], TURNED[3]]}), "finite numbers"),
    "place of four": (as_json({"t": [1, 2, 3, 1], "rpy": [0, 0, 1]}), "expected 3 numbers, got 4"),
    "long quaternion": (by_turn(q_wxyz=[1, 0, 0, 0.1]), "length 1, got 1.0050"),
    "great radians": (by_turn(rpy_rad=[0, 90, 0]), "radians of rpy up to 2 pi, got 90; fix: say"),
    "units of angles": (
        as_json(*({"t": [0, 0, 0], key: [0, 0, 1]} for key in ("rpy", "rpy_deg"))),
        r"one form, got rpy \(open\), rpy \(rpy_deg\)",
    ),
    "no number": (by_turn(q_wxyz="world"), "expected numbers, got 'world'"),
    "message": (by_turn(orientation={"x": 0, "y": 0, "z": 0}), "expected the keys x, y, z, w"),
    "empty": ("", "expected a pose in each line"),
    "CSV, name twice": (f"{ROW}\n{ROW}\n", "`a`: expected each name once, got it twice"),
    "CSV, named twice below a header": (f"{HEADER}\n{ROW}\n{ROW}\n", "`a`: expected each name"),
    "CSV, columns": (f"{HEADER},unit\n{ROW},mm\n", "columns: expected name, .*, got `unit`; fix"),
    "CSV, column twice": (f"{HEADER},x\n{ROW},1\n", "`x`: expected each name once"),
    "CSV, NaN": (f"{ROW}\nb,nan,2,3,1,0,0,0\n", "pose `b`: expected a number, got 'nan'"),
    "CSV, long quaternion": (f"{HEADER}\na,1,2,3,2,0,0,0\n", "length 1, got 2.0000"),
    "CSV, mirrored": ("a,1,0,0,0,0,1,0,0,0,0,-1,0,0,0,0,1\n", "a mirrored one"),
    "CSV, great radians": ("x,y,z,roll_rad,pitch_rad,yaw_rad\n1,2,3,0,90,0\n", "2 pi, got 90"),
    "ROS, name twice": (by_ros("a", "a"), "`a`: expected each name once"),
    "ROS, unit": (by_ros("a", more="unit: mm\n"), "expected metres, as ROS has them, and no `unit"),
    "ROS, several poses": (
        by_ros("a", more="position:\n  x: 1\n"),
        "expected one position .* got 2",
    ),
    "ROS, frames": (
        f"{by_ros('a', more='frame_id: base')}\n---\n{by_ros('b', more='frame_id: tool')}\n",
        "frames: .* got frame_id: base and frame_id: tool",
    ),
    "ROS, NaN": (by_ros("a", x=".nan"), "expected a number `x` of position, got .nan"),
    "ROS, decimal comma": (by_ros("a", x="0,5"), "expected a number `x` of position, got 0,5"),
    "ROS, long quaternion": (by_ros("a", w="0.6"), "pose `a`: expected a quaternion of length 1"),
}


@pytest.mark.parametrize("kind", MISREAD)
def test_poses_that_would_be_misread_are_refused(kind, tmp_path):
    text, words = MISREAD[kind]
    path = tmp_path / "poses"
    path.write_text(text)
    with pytest.raises(ValueError, match=words) as error:
        robot_poses.load(path)
    assert str(error.value).startswith(f"{path}: ")


SAID = {"unit": "cm", "direction": "base_from_hand"}


@pytest.mark.parametrize(
    ("text", "asked", "words"),
    [
        (as_json(HAND, **SAID), {"unit": "m"}, "expected cm, as their file has it, got m; fix"),
        (as_json(HAND), {"direction": "hand_from_base"}, "expected base_from_hand, as their file"),
        (by_turn(q_wxyz=[1, 0, 0, 0]), {"rotation": "xyzw"}, "expected wxyz, as their file has it"),
        (as_json(HAND), {"rotation": "rpy"}, "rotation of poses: expected matrix, got 'rpy'"),
        (by_turn(rpy=[0, 90, 0]), {"rotation": "rpy"}, "up to 2 pi, got 90; fix: say rpy_deg"),
        ("1,2,3,0,90,0\n", {"rotation": "rotvec"}, "up to 2 pi, got 90; fix: say rotvec_deg"),
        (by_ros("a"), {"unit": "mm"}, "expected m, as their file has it, got mm"),
        ("x_mm,y_mm,z_mm,a,b,c\n1,2,3,0,90,0\n", {"unit": "m"}, "expected mm, as their file"),
        (f"{ROW}\n", {"direction": "world"}, "base_from_hand or hand_from_base, got 'world'"),
    ],
)
def test_what_is_asked_for_against_the_file_is_refused(text, asked, words, tmp_path):
    path = tmp_path / "poses"
    path.write_text(text)
    poses = robot_poses.load(path)
    left = dict(zip(("rotation", "direction", "unit"), poses.readings(), strict=True))
    reading = {name: names[0] for name, names in left.items()}
    with pytest.raises(ValueError, match=words):
        poses.read(**(reading | asked))
    with pytest.raises(ValueError, match=words):
        hand_eye.solve({}, poses, eye="hand", **asked)


@pytest.mark.parametrize(
    ("text", "rotations"),
    [
        (by_turn(rpy=[0, 1, 0]), ["rpy", "rpy_deg"]),
        (by_turn(rpy=[0, 90, 0]), ["rpy_deg"]),
        (by_turn(rpy_rad=[0, 1, 0]), ["rpy"]),
        (by_turn(rotvec=[0, 1, 0]), ["rotvec", "rotvec_deg"]),
        (by_turn(rotvec_deg=[0, 1, 0]), ["rotvec_deg"]),
        ("1,2,3,0,90,0\n", ["rotvec_deg", "rpy_deg", "abc_deg"]),
        ("x,y,z,roll,pitch,yaw\n1,2,3,0,1,0\n", ["rpy", "rpy_deg"]),
    ],
)
def test_angles_without_their_unit_are_open(text, rotations, tmp_path):
    path = tmp_path / "poses"
    path.write_text(text)
    assert robot_poses.load(path).readings()[0] == rotations


@pytest.mark.parametrize("text", [as_json(HAND, **SAID), "x_cm,y_cm,z_cm,a,b,c\n.1,.2,.3,90,0,0\n"])
def test_centimetres_are_read(text, tmp_path):
    path = tmp_path / "poses"
    path.write_text(text)
    poses = robot_poses.load(path)
    (found,) = poses.read(poses.rotation, "base_from_hand", poses.unit).values()
    np.testing.assert_allclose(found[:3, :3], np.array(TURNED)[:3, :3], atol=1e-9)
    np.testing.assert_allclose(found[:3, 3], [0.001, 0.002, 0.003])


def test_the_unit_of_angles_must_be_said_without_images(tmp_path, capsys):
    rig, poses, out = (tmp_path / name for name in ("rig.json", "poses.json", "views.json"))
    mvtop.Rig([mvtop.Camera([[700, 0, 320], [0, 700, 240], [0, 0, 1]], (640, 480))]).save(rig)
    turns = ({"t": [10 * i, 0, 0], "rpy": [0, 90 * i, 0]} for i in range(3))
    poses.write_text(as_json(*turns, **SAID))
    typed = ["hand-eye", f"--rig={rig}", f"--robot-poses={poses}", f"--out={out}"]
    assert main(typed) == 2 and "fix: --rotation rpy_deg" in capsys.readouterr().err
    assert main([*typed, "--rotation=rpy"]) == 2 and "2 pi, got 180" in capsys.readouterr().err
    assert main([*typed, "--rotation=rpy_deg"]) == 0
    camera = mvtop.Rig.load(out).cameras[1]
    np.testing.assert_allclose(camera.world_from_cam[:3, 2], [1, 0, 0], atol=1e-9)
    np.testing.assert_allclose(camera.world_from_cam[:3, 3], [0.1, 0, 0])


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


def test_columns_beside_a_pose_do_no_harm(tmp_path):
    path = tmp_path / "poses.csv"
    path.write_text("name,timestamp,x,y,z,qw,qx,qy,qz,joint_1\na,12.5,1,2,3,1,0,0,0,0.4\n")
    pose = robot_poses.load(path).read("wxyz", "base_from_hand", "m")["a"]
    assert pose[:3, 3].tolist() == [1, 2, 3]
    path.write_text("name,x,y,z,qw,qx,qy,qz,tool\na,1,2,3,1,0,0,0,0.1\n")
    with pytest.raises(ValueError, match="`tool`"):
        robot_poses.load(path)

"""Boards: their files, what is detected of them in images, and how they are printed."""

import json

import numpy as np
import pytest
from boards import (
    APRILGRID,
    CHARUCO,
    CHESSBOARD,
    TAGS,
    Renderer,
    board_at,
    needs_calibrate,
    rig_of_three,
)

from mvtop.calibration import Board, detect, observe, rigid
from mvtop.calibration.commands import main

pytestmark = needs_calibrate

WRONG_BOARDS = {
    "no key of a charuco": {"colums": 3},
    "`marker`: expected less than `square`": {"marker": 60},
    "hints at a wrong `unit`": {"unit": "m"},
    "`unit`: expected m, cm or mm": {"unit": "inch"},
    "`columns`: expected a whole number": {"columns": 6.5},
    "has 50 markers, but": {"dictionary": "4X4_50", "columns": 20, "rows": 20},
    "`dictionary`: expected tag16h5": {"dictionary": "5x5"},
    "`kind`: expected one of charuco": {"kind": "circles"},
    "`version`: expected 1": {"version": 2},
}


@pytest.mark.parametrize("words", WRONG_BOARDS)
def test_wrong_boards_are_refused(words):
    with pytest.raises(ValueError, match=words):
        Board.from_dict(CHARUCO | WRONG_BOARDS[words])


@pytest.mark.parametrize(
    "values", [CHARUCO, CHESSBOARD, APRILGRID, TAGS, APRILGRID | {"from": "bottom"}]
)
def test_board_files_are_read_back_equal(values, tmp_path):
    board = Board.from_dict(values)
    path = tmp_path / "board.json"
    path.write_text(json.dumps(board.to_dict()))
    again = Board.load(path)
    np.testing.assert_allclose(again.points, board.points)
    assert (again.ids, again.kind, again.dictionary) == (board.ids, board.kind, board.dictionary)


def test_targets_of_kalibr_are_read(tmp_path):
    path = tmp_path / "april.yaml"
    path.write_text(
        "target_type: 'aprilgrid' #gridtype\ntagCols: 6\ntagRows: 6\ntagSize: 0.088 # "
        "m\ntagSpacing: 0.3\n"
    )
    board = Board.load(path)
    assert board.ids[0] == 30 and board.border == 2 and board.marker == pytest.approx(0.0264)
    path.write_text("target_type: circlegrid\n")
    with pytest.raises(ValueError, match="expected aprilgrid or checkerboard"):
        Board.load(path)


@pytest.fixture(scope="module")
def shots():
    """Rendered images of each kind of board, and the pixels of its points."""
    camera = rig_of_three()[0]
    made = {}
    for name, values in {
        "charuco": CHARUCO,
        "chessboard": CHESSBOARD,
        "april": APRILGRID,
        "tags": TAGS,
    }.items():
        board = Board.from_dict(values)
        place = board_at(board, [0.02, 0.01, -0.05], [15, -20, 8])
        image = Renderer(board).render(camera, place)
        points = rigid.apply(np.linalg.inv(camera.world_from_cam) @ place, board.points)
        made[name] = board, image, camera.project(points)
    return made


@pytest.mark.parametrize("kind", ["charuco", "chessboard", "april", "tags"])
def test_corners_are_where_they_are(shots, kind):
    board, image, pixels = shots[kind]
    found = detect.Detector(board).detect(image)
    assert len(found) == len(board.points)
    off = found.pixels - pixels[found.numbers]
    assert np.abs(off.mean(axis=0)).max() < 0.08 and np.sqrt((off**2).mean()) < 0.2


@pytest.mark.parametrize("kind", ["charuco", "april"])
def test_boards_that_are_hidden_in_part_count(shots, kind):
    board, image, pixels = shots[kind]
    hidden = image.copy()
    hidden[:, 320:] = 120
    found = detect.Detector(board).detect(hidden)
    assert detect.counts(board, found) and len(found) < 0.7 * len(board.points)
    assert np.abs(found.pixels - pixels[found.numbers]).max() < 1


def test_another_board_is_recognised(shots):
    board, image, _ = shots["charuco"]
    turned = Board.from_dict(CHARUCO | {"columns": 7, "rows": 9})
    with pytest.raises(ValueError, match="a board of 9 columns and 7 rows"):
        observe.observe({"a": {"0": image}}, turned)
    other = Board.from_dict(CHARUCO | {"dictionary": "6X6_100"})
    with pytest.raises(ValueError, match="markers of 4X4"):
        observe.observe({"a": {"0": image}}, other)
    _, chess, _ = shots["chessboard"]
    inner = Board.from_dict(CHESSBOARD | {"columns": 8, "rows": 5})
    with pytest.raises(ValueError, match="one of 9 x 6 squares: its file may count inner corners"):
        observe.observe({"a": {"0": chess}}, inner)


def test_images_of_several_sizes_are_refused(shots):
    board, image, _ = shots["charuco"]
    with pytest.raises(ValueError, match="the image is 480x640.*turned by 90 degrees"):
        observe.observe({"a": {"0": image, "1": np.ascontiguousarray(image.T)}}, board)


def test_a_board_is_printed(tmp_path, capsys):
    out = tmp_path / "board.pdf"
    options = ["--kind", "charuco", "--columns", "7", "--rows", "5", "--square", "30mm"]
    assert main(["board", *options, "-o", str(out)]) == 0
    assert out.read_bytes().startswith(b"%PDF-1.6") and "210.00 mm wide" in capsys.readouterr().out
    assert Board.load(tmp_path / "board.json").square == pytest.approx(0.03)
    assert main(["board", *options, "-o", str(out)]) == 2
    assert "exists already; give --force" in capsys.readouterr().err
    assert main(["board", "--from", str(tmp_path / "board.json"), "-o", str(out), "--force"]) == 0
    assert main(["board", *options, "--paper", "a4", "-o", str(tmp_path / "b.svg")]) == 0
    assert (tmp_path / "b.svg").read_text().startswith("<svg")


def test_the_print_is_what_opencv_would_print():
    for rows, legacy in ((7, False), (6, False), (6, True)):
        board = Board.from_dict(CHARUCO | {"rows": rows, "legacy": legacy})
        from mvtop.calibration.printing import texture

        image, _ = texture(board, 1000.0, 0.0)
        theirs = board.cv_charuco().generateImage((450, 50 * rows), marginSize=0)
        assert np.mean((image > 127) != (theirs > 127)) < 0.02

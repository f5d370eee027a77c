"""Rigs from boards: exact truth, and every kind of input that is refused."""

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest
from boards import (
    CHARUCO,
    CHESSBOARD,
    HEAD,
    Renderer,
    board_at,
    look_at,
    needs_calibrate,
    rig_of_three,
)

import mvtop
from mvtop.calibration import Board, calibrate, detect, images, lenses, observe, outliers, rigid
from mvtop.calibration.commands import main

pytestmark = needs_calibrate

LENSES = {"top": "fisheye"}


@pytest.fixture
def seen(monkeypatch):
    """Stands in for detection: corners of boards as cameras see them, with noise.

    Images are of one color; an exposure's board is where `places` has it.
    """

    def make(cameras, board, places, noise=0.05, seed=0, least=0, moved=None, change=None):
        rng = np.random.default_rng(seed)
        found, sizes = {}, {}
        for camera in cameras:
            found[camera.id] = {}
            sizes[camera.id] = camera.size
            for name, place in places.items():
                place = (moved or {}).get((camera.id, name), place)
                points = rigid.apply(np.linalg.inv(camera.world_from_cam) @ place, board.points)
                pixels = camera.project(points)
                inside = (pixels > 2).all(axis=1) & (pixels < np.array(camera.size) - 3).all(axis=1)
                if (numbers := np.flatnonzero(inside)).size > least:
                    noisy = pixels[inside] + rng.normal(size=(len(numbers), 2)) * noise
                    found[camera.id][name] = detect.Detection(numbers, noisy)
        if change is not None:
            change(found)
        told = {
            c: {k: v for k, v in f.items() if detect.counts(board, v)} for c, f in found.items()
        }
        scraps = {c: {k: v for k, v in f.items() if k not in told[c]} for c, f in found.items()}
        sources = {c.id: dict.fromkeys(places, np.zeros((8, 8), np.uint8)) for c in cameras}

        def observed(given, board, *, progress=None):
            kept = {c: told[c] for c in given}
            return observe.Observations(board, given, sizes, kept, {c: scraps[c] for c in given})

        monkeypatch.setattr(observe, "observe", observed)
        return sources

    return make


def scattered(board, count=20, seed=3, spread=(0.22, 0.16, 0.15), tilt=(30, 30, 40)):
    rng = np.random.default_rng(seed)
    return {
        f"{i:03}": board_at(board, rng.uniform(-1, 1, 3) * spread, rng.uniform(-1, 1, 3) * tilt)
        for i in range(count)
    }


def errors(rig, cameras, at_m=1.0):
    """Of each camera against the first, degrees and mm; of a point that far before it, mm."""
    truth = {camera.id: camera for camera in cameras}
    first = rig.cameras[0]
    told = []
    for camera in rig.cameras[1:]:
        shown = np.linalg.inv(first.world_from_cam) @ camera.world_from_cam
        true = np.linalg.inv(truth[first.id].world_from_cam) @ truth[camera.id].world_from_cam
        off = np.linalg.inv(true) @ shown
        told.append((rigid.angle_deg(off[:3, :3]), 1e3 * np.linalg.norm(off[:3, 3])))
    return np.array(told)


def across(rig, cameras):
    """How far lines of sight to points a metre away are off between cameras, mm: lens and place
    together."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (200, 3)) * [0.2, 0.15, 0.1]
    truth = {camera.id: camera for camera in cameras}
    world = truth[rig.cameras[0].id].world_from_cam
    told = []
    for camera in rig.cameras:
        true = truth[camera.id]
        seen = true.project(rigid.apply(np.linalg.inv(true.world_from_cam), points))
        sight = rigid.apply(world @ camera.world_from_cam, camera.unproject(seen))
        center = (world @ camera.world_from_cam)[:3, 3]
        ray = sight - center
        to = points - center
        off = to - (to * ray).sum(axis=1, keepdims=True) * ray
        told.append(1e3 * np.linalg.norm(off, axis=1))
    return np.array(told)


def between_boards(told, places):
    """How far boards a metre away are off against each other, mean over all pairs: degrees, mm."""
    names, off = list(told.world_from_board), []
    middle = told.board.points.mean(axis=0)
    for i, a in enumerate(names):
        for b in names[:i]:
            shown = np.linalg.inv(told.world_from_board[a]) @ told.world_from_board[b]
            wrong = np.linalg.inv(np.linalg.inv(places[a]) @ places[b]) @ shown
            shift = rigid.apply(wrong, middle[None])[0] - middle
            off.append((rigid.angle_deg(wrong[:3, :3]), 1e3 * np.linalg.norm(shift)))
    return np.mean(off, axis=0)


def test_exact_corners_give_the_exact_rig(seen):
    cameras, board = rig_of_three(), Board.from_dict(CHARUCO)
    places = scattered(board)
    told = calibrate(seen(cameras, board, places, noise=0.0), board, lens=LENSES, hold_out=False)
    assert errors(told.rig, cameras).max() < 1e-3
    for shown, true in zip(told.rig.cameras, cameras, strict=True):
        np.testing.assert_allclose(shown.K, true.K, atol=1e-2)
    # Boards, in the first camera's frame.
    for name, place in places.items():
        expected = np.linalg.inv(cameras[0].world_from_cam) @ place
        np.testing.assert_allclose(told.world_from_board[name], expected, atol=1e-5)


def test_noisy_corners_are_within_what_it_says(seen):
    cameras, board = rig_of_three(), Board.from_dict(CHARUCO)
    places = scattered(board, 30)
    told = calibrate(seen(cameras, board, places), board, lens=LENSES)
    off = errors(told.rig, cameras)
    for (turn, shift), camera in zip(off, told.cameras[1:], strict=True):
        assert turn < 4 * camera.turn_sd_deg and shift < 4 * camera.shift_sd_mm
        assert 0.001 < camera.turn_sd_deg < 0.1
    assert off[:, 0].mean() < 0.05
    turn, shift = between_boards(told, places)
    assert turn < 0.02 and shift < 0.1
    assert not told.outliers
    # The verdict on what was held out is as good as the rig is.
    turn = np.median([h.turn_deg for h in told.held_out])
    assert 0.001 < turn < 0.1
    assert len({h.exposure for h in told.held_out}) == 30


def test_a_board_that_moved_between_images_is_named(seen):
    cameras, board = rig_of_three(), Board.from_dict(CHARUCO)
    places = scattered(board)
    shifted = places["007"].copy()
    shifted[:3, 3] += [0.012, 0, 0]
    sources = seen(cameras, board, places, moved={("right", "007"): shifted})
    told = calibrate(sources, board, lens=LENSES, hold_out=False)
    assert [(o.camera, o.exposure) for o in told.outliers] == [("right", "007")]
    assert "12." in told.outliers[0].why or "11." in told.outliers[0].why
    assert "mm" in told.outliers[0].why and "the board moved" in told.outliers[0].why
    assert errors(told.rig, cameras)[:, 0].mean() < 0.1


@pytest.mark.parametrize(
    ("camera", "exposure", "worst"),
    # By 0 all that seems off goes out at once, and what fits comes back.
    [("left", "003", outliers.WORST), ("right", "014", outliers.WORST), ("right", "014", 0.0)],
)
def test_an_image_that_is_turned_blames_no_other(seen, monkeypatch, camera, exposure, worst):
    monkeypatch.setattr(outliers, "WORST", worst)
    cameras, board = rig_of_three()[:2], Board.from_dict(CHARUCO)

    def turn(found):
        view = found[camera][exposure]
        found[camera][exposure] = detect.Detection(view.numbers, [639, 479] - view.pixels)

    sources = seen(cameras, board, scattered(board, 16), change=turn)
    told = calibrate(sources, board, hold_out=False)
    assert {o.exposure for o in told.outliers} == {exposure}
    assert sum(c.views for c in told.cameras) == 30
    # By the final solution, whose lenses are right.
    assert all("180.0 degrees from" in o.why and "one is turned" in o.why for o in told.outliers)
    assert errors(told.rig, cameras)[:, 0].max() < 0.2


def test_chains_of_boards_link_cameras_that_share_none(seen):
    board = Board.from_dict(CHARUCO)
    cameras = [
        mvtop.Camera(
            [[700, 0, 320], [0, 700, 240], [0, 0, 1]],
            (640, 480),
            id=f"c{i}",
            world_from_cam=look_at([1.0 * i, 0, -1.0], [1.0 * i, 0, 0]),
        )
        for i in range(3)
    ]
    places = {}
    for i, (at, tilt) in enumerate(
        (x, t) for x in (0.0, 0.5, 1.0, 1.5, 2.0) for t in ([25, 0, 0], [-20, 20, 10], [10, -25, 0])
    ):
        places[f"{i:02}"] = board_at(board, [at, 0.05 * (i % 3), 0.1 * (i % 2)], tilt)
    told = calibrate(seen(cameras, board, places), board, lens="pinhole4", hold_out=False)
    both = [h for h in told.residuals if h[0] == "c0"]
    other = [h for h in told.residuals if h[0] == "c2"]
    assert not {e for _, e in both} & {e for _, e in other}
    assert errors(told.rig, cameras)[:, 0].max() < 0.5


def test_a_camera_that_is_not_linked_is_named_with_the_nearest_chance(seen):
    board = Board.from_dict(CHARUCO)
    cameras = rig_of_three()[:2]
    far = look_at([5, 0, -1], [5, 0, 0])
    cameras.append(
        mvtop.Camera(
            [[700, 0, 320], [0, 700, 240], [0, 0, 1]], (640, 480), id="top", world_from_cam=far
        )
    )
    places = scattered(board, 8)
    tilts = ([25, 0, 0], [-20, 20, 10], [10, -25, 0], [0, 20, 30], [20, 20, 0])
    places |= {f"1{i:02}": board_at(board, [5, 0, 0.1 * i], t) for i, t in enumerate(tilts)}
    with pytest.raises(ValueError, match="camera `top` shares no exposure with any other camera"):
        calibrate(seen(cameras, board, places), board)
    with pytest.raises(ValueError, match="nearest are exposure `100`, where `top` sees .*`007`"):
        calibrate(seen(cameras, board, places), board)


def test_parallel_boards_do_not_fix_a_focal_length(seen):
    board = Board.from_dict(CHARUCO)
    camera = mvtop.Camera(
        [[700, 0, 320], [0, 700, 240], [0, 0, 1]],
        (640, 480),
        world_from_cam=look_at([0, 0, -1], [0, 0, 0]),
    )
    places = {f"{i}": board_at(board, [0.02 * i - 0.1, 0.01 * i, 0.0]) for i in range(8)}
    with pytest.raises(ValueError, match="focal length is not determined.*tilt the board"):
        calibrate(seen([camera], board, places), board)


def test_lenses_that_are_given_are_kept(seen):
    cameras, board = rig_of_three(), Board.from_dict(CHARUCO)
    sources = seen(cameras, board, scattered(board, 6))
    told = calibrate(sources, board, intrinsics=mvtop.Rig(cameras), hold_out=False)
    for shown, true in zip(told.rig.cameras, cameras, strict=True):
        np.testing.assert_array_equal(shown.K, true.K)
    assert errors(told.rig, cameras)[:, 0].mean() < 0.02
    assert told.cameras[0].focal_sd_px == 0
    turned = mvtop.Camera([[700, 0, 238], [0, 702, 322], [0, 0, 1]], (480, 640), id="left")
    with pytest.raises(ValueError, match="640x480.*480x640; width and height are swapped"):
        calibrate(sources, board, intrinsics=mvtop.Rig([turned]))


def test_the_world_is_a_board_where_asked_for(seen):
    cameras, board = rig_of_three(), Board.from_dict(CHARUCO)
    sources = seen(cameras, board, scattered(board, 8))
    told = calibrate(sources, board, lens=LENSES, world="003", hold_out=False)
    np.testing.assert_allclose(told.world_from_board["003"], np.eye(4), atol=1e-9)
    with pytest.raises(ValueError, match="world: no exposure `x`"):
        calibrate(sources, board, lens=LENSES, world="x", hold_out=False)


def test_the_measured_size_of_the_print_is_used(seen):
    cameras, board = rig_of_three(), Board.from_dict(CHARUCO)
    sources = seen(cameras, board.scaled(0.98), scattered(board.scaled(0.98), 8))
    told = calibrate(sources, board, lens=LENSES, measured=0.441, hold_out=False)
    assert told.scale.what == "the pattern's width" and "2.00% smaller" in str(told.scale)
    assert errors(told.rig, cameras)[:, 1].max() < 2
    with pytest.raises(ValueError, match="within 10 % of no length"):
        calibrate(sources, board, measured=0.2)


@pytest.mark.parametrize("kind", list(lenses.KINDS))
def test_derivatives_of_lenses(kind, rng):
    lens_kind = lenses.KINDS[kind]
    lens = np.r_[800, 810, 320, 240, rng.normal(size=lens_kind.coefficients) * 0.03]
    points = rng.normal(size=(20, 3)) * 0.4 + [0, 0, 2]
    pixels, by_point, by_lens = lenses.project(lens_kind, lens, points)
    camera = mvtop.Camera(
        [[800, 0, 320], [0, 810, 240], [0, 0, 1]],
        (640, 480),
        distortion=lens[4:],
        model=lens_kind.model,
        max_angle_deg=60,
    )
    np.testing.assert_allclose(pixels, camera.project(points), atol=1e-9)
    step = 1e-6
    for j in range(3):
        move = np.eye(3)[j] * step
        ends = [lenses.project(lens_kind, lens, points + s * move)[0] for s in (1, -1)]
        np.testing.assert_allclose((ends[0] - ends[1]) / 2 / step, by_point[:, :, j], atol=1e-4)
    for j in range(lens_kind.size):
        move = np.eye(lens_kind.size)[j] * step
        ends = [lenses.project(lens_kind, lens + s * move, points)[0] for s in (1, -1)]
        np.testing.assert_allclose((ends[0] - ends[1]) / 2 / step, by_lens[:, :, j], atol=1e-4)
    flat = lenses.unbend(lens_kind, lens, pixels)
    np.testing.assert_allclose(flat, points[:, :2] / points[:, 2:], atol=1e-6)


LAYOUTS = {
    "exposure/camera": ["001/left.png", "001/right.png", "002/left.png", "002/right.png"],
    "camera/exposure": ["left/001.png", "right/001.png", "left/002.png", "right/002.png"],
    "flat": ["left_001.png", "right_001.png", "left002.png", "right-002.png"],
    "BOP": ["rgb_left/000001.png", "rgb_right/000001.png", "depth_left/000001.png"],
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_layouts_are_recognised(layout, tmp_path):
    for name in LAYOUTS[layout]:
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.touch()
    found = images.find([tmp_path]).images
    assert sorted(found) == ["left", "right"]
    assert sorted(found["left"]) == (["000001"] if layout == "BOP" else ["001", "002"])


def test_folders_of_cameras(tmp_path):
    for name in ("a/1.png", "a/2.png", "b/1.png", "b/2.png"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    found = images.find([tmp_path / "a", tmp_path / "b"]).images
    assert {camera: sorted(of) for camera, of in found.items()} == {
        "a": ["1", "2"],
        "b": ["1", "2"],
    }
    with pytest.raises(FileNotFoundError, match="expected a folder"):
        images.find([tmp_path / "c"])


def test_the_command_writes_a_rig_and_a_page(tmp_path, capsys):
    import cv2

    cameras, board = rig_of_three()[:1], Board.from_dict(CHARUCO)
    (tmp_path / "board.json").write_text(json.dumps(CHARUCO))
    renderer = Renderer(board)
    for name, place in scattered(board, 7, spread=(0.1, 0.08, 0.1)).items():
        path = tmp_path / f"shots/{name}/left.png"
        path.parent.mkdir(parents=True)
        cv2.imwrite(str(path), renderer.render(cameras[0], place))
    out, page = tmp_path / "rig.json", tmp_path / "page.html"
    typed = [
        "calibrate",
        "--board",
        tmp_path / "board.json",
        tmp_path / "shots",
        "-o",
        out,
        "--page",
        page,
    ]
    assert main([str(part) for part in typed]) == 0, capsys.readouterr().err
    told = capsys.readouterr().out
    assert "held out, at" in told and "7 exposures of a charuco" in told
    assert mvtop.Rig.load(out).cameras[0].id == "left"
    assert page.read_text().count("data:image/jpeg;base64,") >= 2
    assert main([str(part) for part in typed]) == 2
    assert "exists already; give --force" in capsys.readouterr().err
    assert main([*map(str, typed), "--force", "--cameras", "nobody"]) == 2
    assert "no camera `nobody`; expected one of left" in capsys.readouterr().err


def test_rendered_boards_give_the_rig():
    cameras, board = rig_of_three(), Board.from_dict(CHARUCO)
    renderer, places = Renderer(board), scattered(board, 20, spread=(0.3, 0.22, 0.2))
    shots = {
        c.id: {
            name: renderer.render(c, place, seed=i)
            for i, (name, place) in enumerate(places.items())
        }
        for c in cameras
    }
    told = calibrate(shots, board, lens=LENSES, hold_out=False)
    off = errors(told.rig, cameras)
    assert off[:, 0].mean() < 0.05
    assert across(told.rig, cameras).mean() < 0.1
    turn, shift = between_boards(told, places)
    assert turn < 0.02 and shift < 0.1


OPENCV_DOC = Path("/usr/share/doc/opencv-doc/examples/data")


@pytest.fixture(scope="module")
def stereo_images(tmp_path_factory):
    """The chessboard that Debian's package opencv-doc has, left and right."""
    if OPENCV_DOC.is_dir():
        return OPENCV_DOC
    folder = tmp_path_factory.mktemp("opencv-doc")
    try:
        fetch = ["apt-get", "download", "opencv-doc"]
        subprocess.run(fetch, cwd=folder, capture_output=True, timeout=60, check=True)
        (package,) = folder.glob("*.deb")
        unpack = ["dpkg-deb", "-x", str(package), str(folder)]
        subprocess.run(unpack, capture_output=True, timeout=60, check=True)
    except (OSError, ValueError, subprocess.SubprocessError) as cause:
        pytest.skip(f"Debian's package opencv-doc cannot be downloaded: {cause}")
    return folder / str(OPENCV_DOC).lstrip("/")


def test_photographs_of_a_chessboard(stereo_images, tmp_path):
    for path in [*stereo_images.glob("left0?.jpg"), *stereo_images.glob("right0?.jpg")]:
        (tmp_path / path.name).symlink_to(path)
    board = HEAD | {"kind": "chessboard", "columns": 10, "rows": 7, "square": 25}
    told = calibrate(tmp_path, board, hold_out=False)
    left, right = told.rig.cameras
    # OpenCV's own calibration of these images: focal lengths of 533 px, 3.35 squares apart, 0.2 px.
    assert left.K[0, 0] == pytest.approx(534, abs=8)
    distance = np.linalg.norm(right.world_from_cam[:3, 3] - left.world_from_cam[:3, 3])
    assert distance / 0.025 == pytest.approx(3.34, abs=0.06)
    assert max(camera.px for camera in told.cameras) < 0.6


def test_names_of_files_are_shown_with_control_characters_escaped(tmp_path, capsys):
    board = tmp_path / "board.json"
    board.write_text(json.dumps(CHESSBOARD | {"x\x1b[2J\x9b\u202e": 1}))
    code = main(["calibrate", "--board", str(board), str(tmp_path), "-o", str(tmp_path / "r.json")])
    assert code == 2 and r"`x\u001b[2J\u009b\u202e`: no key of a" in capsys.readouterr().err
    named = tmp_path / "a\x1b[31m.pdf"
    size = ["--columns", "5", "--rows", "4", "--square", "30mm"]
    assert main(["board", "--kind", "chessboard", *size, "-o", str(named)]) == 0
    told = capsys.readouterr()
    assert named.exists() and r"a\u001b[31m.pdf" in told.out and "\x1b" not in told.out + told.err

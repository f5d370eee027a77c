"""A rig from the same corners by `mvtop.calibrate` and by OpenCV's `calibrateMultiview`.

    python benches/calibration.py --rigs 5

Three cameras (two pinhole, one fisheye) see a ChArUco board in 20 exposures; corners have noise of
0.1 px. Detection is left out: both solve the same numbers, in turn. Both get images that show the
whole board, as OpenCV does not converge where corners are left out (marked by -1, OpenCV 5.0); then
mvtop gets images that show a part of it as well. Errors are of the cameras against the first one,
beside the rig that made the corners.
"""

import argparse
import sys
import time
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "crates/mvtop-py/tests"))

from boards import CHARUCO, rig_of_three  # noqa: E402
from test_calibrate import LENSES, errors, scattered  # noqa: E402

from mvtop.calibration import Board, calibrate, detect, observe, rigid  # noqa: E402

EXPOSURES = 20
NOISE_PX = 0.1


def corners(cameras, board, places, seed):
    """Of each camera and exposure, the numbers and pixels of the corners inside the image."""
    rng, found = np.random.default_rng(seed), {}
    for camera in cameras:
        found[camera.id] = {}
        for name, place in places.items():
            cam_from_board = np.linalg.inv(camera.world_from_cam) @ place
            pixels = camera.project(rigid.apply(cam_from_board, board.points))
            inside = (pixels > 2).all(axis=1) & (pixels < np.array(camera.size) - 3).all(axis=1)
            numbers = np.flatnonzero(inside)
            noisy = pixels[inside] + rng.normal(size=(len(numbers), 2)) * NOISE_PX
            found[camera.id][name] = detect.Detection(numbers, noisy)
    return found


def of_mvtop(cameras, board, found):
    """Errors (degrees, mm) of each camera, and seconds."""
    counted = {
        c: {k: v for k, v in all_of.items() if detect.counts(board, v)}
        for c, all_of in found.items()
    }
    sizes = {camera.id: camera.size for camera in cameras}

    def observed(given, board, *, progress=None):
        return observe.Observations(board, given, sizes, counted, {c: {} for c in given})

    sources = {c: dict.fromkeys(all_of, np.zeros((8, 8), np.uint8)) for c, all_of in found.items()}
    kept, observe.observe = observe.observe, observed
    try:
        began = time.perf_counter()
        told = calibrate(sources, board, lens=LENSES, hold_out=False)
        return errors(told.rig, cameras), time.perf_counter() - began
    finally:
        observe.observe = kept


def of_opencv(cameras, board, found, names):
    points = board.points.astype(np.float32).reshape(-1, 3)
    mask = np.zeros((len(cameras), len(names)), np.uint8)
    images = []
    for row, camera in enumerate(cameras):
        shown = [found[camera.id][name] for name in names]
        mask[row] = [len(one) == len(points) for one in shown]
        images.append([
            one.pixels.astype(np.float32).reshape(1, -1, 2) if whole else np.zeros(0, np.float32)
            for one, whole in zip(shown, mask[row], strict=True)
        ])  # fmt: skip
    fisheye = [LENSES.get(camera.id) == "fisheye" for camera in cameras]
    kinds = [cv2.CALIB_MODEL_FISHEYE if one else cv2.CALIB_MODEL_PINHOLE for one in fisheye]
    began = time.perf_counter()
    _, _, _, rotations, places = cv2.calibrateMultiview(
        [points] * len(names), images, [camera.size for camera in cameras], mask,
        np.array([kinds], np.uint8), [np.zeros((3, 3)) for _ in cameras],
        [np.zeros((4, 1)) if one else np.zeros((1, 5)) for one in fisheye],
        [np.eye(3) for _ in cameras], [np.zeros((3, 1)) for _ in cameras],
        flagsForIntrinsics=np.zeros((1, len(cameras)), np.int32),
    )  # fmt: skip
    taken, off = time.perf_counter() - began, []
    for camera, rotation, place in zip(cameras[1:], rotations[1:], places[1:], strict=True):
        cam_from_first = np.eye(4)
        cam_from_first[:3, :3] = cv2.Rodrigues(rotation)[0] if rotation.size == 3 else rotation
        cam_from_first[:3, 3] = place.ravel()
        true = np.linalg.inv(cameras[0].world_from_cam) @ camera.world_from_cam
        wrong = np.linalg.inv(true) @ np.linalg.inv(cam_from_first)
        off.append((rigid.angle_deg(wrong[:3, :3]), 1e3 * np.linalg.norm(wrong[:3, 3])))
    return np.array(off), taken


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rigs", type=int, default=5, help="boards and noise drawn so often")
    args = parser.parse_args()
    cameras, board = rig_of_three(), Board.from_dict(CHARUCO)
    rows = {"OpenCV, whole boards": [], "mvtop, whole boards": [], "mvtop, all boards": []}
    for seed in range(args.rigs):
        near = scattered(board, 200, seed, spread=(0.15, 0.1, 0.1), tilt=(25, 25, 40))
        found = corners(cameras, board, near, seed)
        whole = {
            c: {k: v for k, v in all_of.items() if len(v) == len(board.points)}
            for c, all_of in found.items()
        }
        shared = [name for name in near if sum(name in of for of in whole.values()) > 1]
        names = shared[:EXPOSURES]
        some = {c: {k: v for k, v in of.items() if k in names} for c, of in whole.items()}
        rows["OpenCV, whole boards"].append(of_opencv(cameras, board, found, names))
        rows["mvtop, whole boards"].append(of_mvtop(cameras, board, some))
        wide = scattered(board, EXPOSURES, seed, spread=(0.3, 0.22, 0.2))
        rows["mvtop, all boards"].append(
            of_mvtop(cameras, board, corners(cameras, board, wide, seed))
        )
    print(f"{'':22}{'degrees':>9}{'mm':>8}{'seconds':>9}   means of {args.rigs} rigs")
    for name, all_of in rows.items():
        degrees, mm = np.mean([off.mean(axis=0) for off, _ in all_of], axis=0)
        print(f"{name:22}{degrees:9.3f}{mm:8.2f}{np.mean([s for _, s in all_of]):9.1f}")


if __name__ == "__main__":
    main()

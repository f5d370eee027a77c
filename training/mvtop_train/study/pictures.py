"""Draw poses from one and from two views of the same samples side by side.

    python -m mvtop_train.study.pictures --results out/tables/mvball-seed0-100  (or: make pictures)

A row is a sample: its two views, the pose from both drawn into both, and the pose from the first
view alone. Colored axes and points are predicted, thin white axes that end in a dot are true.
Rows are the first samples, not chosen ones. Reads the results and samples of `tables.py`.
"""

import json
import tempfile
from pathlib import Path

import cv2
import numpy as np

from ..errors import UserError, argument_parser, command
from . import results
from .tables import call

CELL = 150  # px
GAP = 4
MARGIN = 0.75  # of the box's size, around it
COLUMNS = ["view 1", "view 2", "both: view 1", "both: view 2", "view 1 alone"]


def window(box: list[float]) -> tuple[float, float, float]:
    """Left, top and side of the square that shows a box with a margin around it, px."""
    x0, y0, x1, y1 = box
    side = (1 + MARGIN) * max(x1 - x0, y1 - y0)
    return (x0 + x1 - side) / 2, (y0 + y1 - side) / 2, side


def cut(image: np.ndarray, box: list[float]) -> np.ndarray:
    """The window around a box, [CELL, CELL, 3]; the image's edge is repeated beyond it."""
    left, top, side = window(box)
    scale = CELL / side
    # Pixel centers are integers: the window's edge is that of the cell, half a pixel before 0.
    shift = -np.array([left, top]) * scale - 0.5
    matrix = np.array([[scale, 0, shift[0]], [0, scale, shift[1]]])
    if scale < 1:  # no flicker from pixels that are jumped over
        image = cv2.GaussianBlur(image, (0, 0), 0.4 / scale)
    return cv2.warpAffine(image, matrix, (CELL, CELL), borderMode=cv2.BORDER_REPLICATE)


def overlays(cli: str, model: Path, sample: Path, cameras: list[str]) -> list[np.ndarray]:
    """Images of some cameras with the pose from them, and the true one."""
    with tempfile.TemporaryDirectory() as folder:
        call([
            cli, "infer", "--rig", str(sample / "rig.json"), "--model", str(model),
            "--truth", str(sample / "truth.json"), "--overlay", folder,
            *[f"{camera}={sample / camera}.png" for camera in cameras],
        ])  # fmt: skip
        return [cv2.imread(f"{folder}/{camera}.png") for camera in cameras]


def row(args, sample: Path) -> np.ndarray:
    cameras = ["cam0", "cam1"]
    boxes = json.loads((sample / "truth.json").read_text())["objects"][0]["boxes"]
    plain = [cv2.imread(str(sample / f"{camera}.png")) for camera in cameras]
    both = overlays(args.cli, args.model, sample, cameras)
    alone = overlays(args.cli, args.model, sample, cameras[:1])
    shown = zip([*plain, *both, *alone], [0, 1, 0, 1, 0], strict=True)
    return tile([cut(image, boxes[cameras[view]]) for image, view in shown])


def tile(cells: list[np.ndarray]) -> np.ndarray:
    """Cells side by side, on white."""
    gap = np.full((cells[0].shape[0], GAP, 3), 255, np.uint8)
    return np.hstack([part for cell in cells for part in (cell, gap)][:-1])


def label(image: np.ndarray, text: str, column: int):
    left, bottom = column * (CELL + GAP), image.shape[0]
    (width, height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.45, 1)
    image[bottom - height - 10 :, left : left + width + 8] = 24
    cv2.putText(
        image, text, (left + 4, bottom - 5), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255,) * 3, 1,
        cv2.LINE_AA,
    )  # fmt: skip


@command
def main():
    parser = argument_parser(__doc__)
    parser.add_argument("--results", type=Path, required=True, help="folder of `tables --out`")
    parser.add_argument("--samples", type=Path, required=True, help="the samples of these results")
    parser.add_argument("--split", choices=["hard", "easy"], default="hard")
    parser.add_argument("--model", type=Path, default=Path("models/mvball"))
    parser.add_argument("--rows", type=int, default=6)
    parser.add_argument("--out", type=Path, default=Path("out/pairs.png"))
    parser.add_argument("--cli", default="target/release/mvtop-cli")
    args = parser.parse_args()
    runs = [results.read(args.results / args.split / f"views{v}.jsonl") for v in (2, 1)]
    two, one = (dict(zip(run.samples, run.rot_deg, strict=True)) for run in runs)
    header = np.full((22, len(COLUMNS) * (CELL + GAP) - GAP, 3), 255, np.uint8)
    for column, text in enumerate(COLUMNS):
        cv2.putText(
            header, text, (column * (CELL + GAP) + 4, 15), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (0, 0, 0)
        )
    rows = [header]
    for name in sorted(two)[: args.rows]:
        if not (args.samples / name).is_dir():
            raise UserError(f"no sample {args.samples / name}; fix: --samples of these results")
        picture = row(args, args.samples / name)
        for column, found in ((2, two[name]), (4, one[name])):
            label(picture, "not found" if np.isnan(found) else f"{found:.1f} deg off", column)
        rows += [picture, np.full((GAP, picture.shape[1], 3), 255, np.uint8)]
    args.out.parent.mkdir(parents=True, exist_ok=True)
    save(args.out, np.vstack(rows[:-1]))
    print(args.out)


def save(path: Path, image: np.ndarray):
    """PNG with a palette: a third of the size. Maximum coverage keeps the rare colors of axes."""
    from PIL import Image

    picture = Image.fromarray(np.ascontiguousarray(image[:, :, ::-1]))
    picture.quantize(256, Image.Quantize.MAXCOVERAGE).save(path, optimize=True)


if __name__ == "__main__":
    main()

"""Render held-out samples as a user would have them: a rig file, one image per camera, the truth.

    python -m mvtop_train.samples --out out/eval --split hard --seed 7 --count 100 --views 2

A sample is a folder with rig.json, <camera>.png and truth.json. Views alternate between the
hemispheres, so that every two neighbours determine the pose; one view gives the same scenes and
first cameras as two. No split shares scenes with training (`generate.SPLITS`).
"""

import argparse
import json
import os
from pathlib import Path

import cv2
import numpy as np
from tqdm import tqdm

from . import generate

MAX_VIEWS = 8


def _rows(pose: np.ndarray) -> list:
    return [[float(x) for x in row] for row in pose]


def write_sample(folder: Path, views):
    """Write `views` (scenes.View, all of one scene) as one sample."""
    from . import mvball, scenes

    folder.mkdir(parents=True, exist_ok=True)
    points = mvball.bounding_points()
    cameras, boxes = [], {}
    for i, view in enumerate(views):
        name = f"cam{i}"
        cv2.imwrite(str(folder / f"{name}.png"), view.rgb[:, :, ::-1])
        cameras.append(
            {
                "id": name,
                "width": scenes.WIDTH, "height": scenes.HEIGHT, "model": "pinhole",
                "fx": view.k[0, 0], "fy": view.k[1, 1], "cx": view.k[0, 2], "cy": view.k[1, 2],
                "T_cam_world": _rows(view.cam_from_world),
            }
        )  # fmt: skip
        boxes[name] = scenes.amodal_box(view, points).tolist()
    rig = {"format": "mvtop-rig", "version": 1, "unit": "m", "reference": "cam0"}
    (folder / "rig.json").write_text(json.dumps({**rig, "cameras": cameras}, indent=1) + "\n")
    truth = {
        "objects": [
            {
                "class": mvball.NAME,
                "T_world_obj": _rows(views[0].world_from_obj),
                "boxes": boxes,
            }
        ]
    }
    (folder / "truth.json").write_text(json.dumps(truth, indent=1) + "\n")


def _work(job):
    out, split, seed, numbers, views, queue = job
    gl = generate.open_gl()
    for number in numbers:
        folder = Path(out) / f"{number:06d}"
        if not (folder / "truth.json").exists():
            count = max(views, 2)  # one view: the first of the pair that two views would be
            order = [("green", "red")[(number + i) % 2] for i in range(count)]
            found = generate.scene_views(gl, seed, split, number, order)
            write_sample(folder, found[:views])
        queue.put(number)


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", required=True)
    parser.add_argument("--split", choices=["easy", "hard"], default="hard")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=100, help="samples to render")
    parser.add_argument("--views", type=int, default=2, choices=range(1, MAX_VIEWS + 1))
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    args = parser.parse_args()
    generate.run_workers(
        _work,
        range(args.count),
        args.workers,
        lambda numbers, queue: (args.out, args.split, args.seed, numbers, args.views, queue),
        tqdm(total=args.count, unit="sample", desc="rendering"),
    )


if __name__ == "__main__":
    main()

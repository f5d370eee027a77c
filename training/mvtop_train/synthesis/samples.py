"""Render held-out samples as a user would have them: a rig file, one image per camera, the truth.

    mvtop-train samples --out out/eval --split hard --seed 7 --views 2
    mvtop-train samples --out out/part --data data/part --split test --count 100

A sample is a folder with rig.json, <camera>.png and truth.json. Views alternate between the
hemispheres, so that every two neighbours determine the pose; one view gives the same scenes and
first cameras as two. No split shares scenes with training (`recipe.SPLITS`). With `--data` the
samples are pairs of a data set in BOP layout (`pairs.py`), spread evenly over the split.
"""

import json
import os
from pathlib import Path

import cv2
import numpy as np
from tqdm import tqdm

from ..data import bop, mvball, objects, pairs, rendered
from ..errors import UserError, argument_parser, command
from . import workers
from .generate import scene_views
from .gl import open_gl

MAX_VIEWS = 8


def write(folder: Path, name: str, world_from_obj: np.ndarray, views: list[tuple]):
    """Write one sample of the object `name`.

    views  (rgb [H, W, 3], k [3, 3], cam_from_world [4, 4], box [4]) per camera, the reference first
    """
    import mvtop  # loads its compiled part

    folder.mkdir(parents=True, exist_ok=True)
    rig, boxes = [], {}
    for i, (rgb, k, cam_from_world, box) in enumerate(views):
        camera, (height, width) = f"cam{i}", rgb.shape[:2]
        bop.write_image(folder / f"{camera}.png", rgb[:, :, ::-1])
        world_from_cam = np.linalg.inv(cam_from_world)
        rig.append(mvtop.Camera(k, (width, height), world_from_cam=world_from_cam, id=camera))
        boxes[camera] = box.tolist()
    (folder / "rig.json").write_text(mvtop.Rig(rig).to_json())
    truth = {"objects": [{"class": name, "T_world_obj": world_from_obj.tolist(), "boxes": boxes}]}
    (folder / "truth.json").write_text(json.dumps(truth, indent=1) + "\n")


def write_sample(folder: Path, views):
    """Write `views` (rendered.View, all of one scene of MV-ball) as one sample."""
    cameras = [(v.rgb, v.k, v.cam_from_world, rendered.amodal_box(v, v.seen[0])) for v in views]
    write(folder, mvball.NAME, views[0].seen[0].world_from_obj, cameras)


def write_from_data(out: Path, root: Path, split: str, obj: objects.Object, count: int, views: int):
    """Samples of a data set's pairs; of three views and more, the rest are the scene's next."""
    found = []
    for scene in bop.read_split(root, split, obj).values():
        alone = [(0,)] if views == 1 else []  # an image without a partner
        for pair in pairs.of_scene({n: image.shows for n, image in enumerate(scene)}) or alone:
            rest = [n for n in range(len(scene)) if n not in pair]
            if len(scene) >= views:
                found.append([scene[n] for n in (*pair, *rest)[:views]])
    if not found:
        raise UserError(
            f"{root}/{split}: expected a scene of {max(views, 2)} images, got none; fix: --views"
        )
    chosen = np.linspace(0, len(found) - 1, min(count, len(found))).astype(int)
    for number, index in enumerate(tqdm(chosen, unit="sample")):
        images = found[index]
        cameras = [
            (cv2.imread(str(x.path))[:, :, ::-1], x.k, x.cam_from_world, x.box) for x in images
        ]
        world_from_obj = np.linalg.inv(images[0].cam_from_world) @ images[0].cam_from_obj
        write(out / f"{number:06d}", obj.name, world_from_obj, cameras)


def _work(job):
    out, split, seed, numbers, views, queue = job
    gl = open_gl()
    for number in workers.while_asked_for(numbers):
        folder = Path(out) / f"{number:06d}"
        if not (folder / "truth.json").exists():
            count = max(views, 2)  # one view: the first of the pair that two views would be
            order = [("green", "red")[(number + i) % 2] for i in range(count)]
            found = scene_views(gl, seed, split, number, order)
            write_sample(folder, found[:views])
        queue.put(number)


@command
def main():
    parser = argument_parser(__doc__)
    parser.add_argument("--out", required=True)
    parser.add_argument("--split", default="hard", help="easy, hard, or one of --data")
    parser.add_argument("--data", type=Path, help="a data set in BOP layout; nothing is rendered")
    parser.add_argument("--object", type=int, metavar="ID", help="of the objects in --data")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=100, help="samples to render")
    parser.add_argument("--views", type=int, default=2, choices=range(1, MAX_VIEWS + 1))
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    args = parser.parse_args()
    if args.data:
        obj = objects.read(args.data, args.object)
        write_from_data(Path(args.out), args.data, args.split, obj, args.count, args.views)
        return
    if args.split not in ("easy", "hard"):
        raise UserError(
            f"--split: expected easy or hard, got {args.split!r}; fix: --data for others"
        )
    workers.run_workers(
        _work,
        range(args.count),
        args.workers,
        lambda numbers, queue: (args.out, args.split, args.seed, numbers, args.views, queue),
        tqdm(total=args.count, unit="sample", desc="rendering"),
    )


if __name__ == "__main__":
    main()

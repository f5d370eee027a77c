"""Poses for a whole BOP data set, on all machines of a Ray cluster.

    python examples/ray_bop.py --data data/mvball --split hard --model models/mvball --out out/hard

Every scene's images are taken in groups of `--views` that follow each other, and each group is one
prediction. Of scenes with several sensors (`scene_camera_cam1.json`, ...) `--sensor` names the one
whose images are taken, as results do not tell images of equal number apart. The groups are dealt
into shards of `--shard-size`, always the same way, and a shard becomes one file of BOP results,
`shards/00000.csv`. It appears under its name when it is whole, so that whoever does the work again,
after a worker was lost or when the command is repeated, writes the same file: nothing is lost and
nothing comes twice. At the end all shards become `results.csv`. Workers read the data set and write
the shards, so both must lie where every machine sees them.

Needs: pip install target/wheels/mvtop-*.whl "ray[data]" pillow, from a clone after `make wheel`
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import ray
from PIL import Image

import mvtop

Group = list[tuple[int, int]]  # (scene, image), reference first


class Predict:
    """A worker: loads the network once, then writes shard after shard."""

    def __init__(
        self, data: str, split: str, sensor: str | None, model: str, out: str, threads: int
    ) -> None:
        self.split = Path(data, split)
        self.sensor = sensor
        self.shards = Path(out, "shards")
        self.estimator = mvtop.Estimator.load(model, threads=threads)

    def __call__(self, row: dict[str, Any]) -> dict[str, Any]:
        path = self.shards / f"{row['shard']:05}.csv"
        # A name of its own: a worker that is thought lost may still be writing.
        partial = path.with_suffix(f".{os.uname().nodename}-{os.getpid()}.partial")
        rows = 0
        with open(partial, "w", encoding="utf-8") as file:
            file.write(mvtop.BOP_RESULTS_HEADER)
            for group in json.loads(row["groups"]):
                lines = self.predict(group)
                file.write(lines)
                file.flush()
                rows += lines.count("\n")
            os.fsync(file.fileno())
        os.replace(partial, path)
        return {"shard": row["shard"], "rows": rows}

    def predict(self, group: Group) -> str:
        scene = group[0][0]
        folder = self.split / f"{scene:06}"
        known = {image.number: image for image in images_of(folder, self.sensor)}
        cameras, images = [], []
        for image in (known[number] for _, number in group):
            if image.cam_from_world is None:
                raise ValueError(
                    f"{folder}: image {image.number}: no cam_R_w2c and cam_t_w2c, add them"
                )
            with Image.open(image.path) as header:
                size = header.size
            cameras.append(
                mvtop.Camera(
                    image.K,
                    size,
                    distortion=image.distortion,
                    world_from_cam=np.linalg.inv(image.cam_from_world),
                    id=str(image.number),
                )
            )
            images.append(image.path)
        # A camera that stood still gives images from one place.
        rig = mvtop.Rig(cameras, trust_unit=True)
        prediction = self.estimator.predict(images, rig)
        im_ids = {str(image): image for _, image in group}
        return prediction.to_bop_csv(scene, im_ids, header=False)


def images_of(scene: Path, sensor: str | None) -> list[mvtop.bop.Image]:
    """The scene's images by one sensor, which has to be named where it has several."""
    images = mvtop.bop.read_scene(scene)
    sensors = sorted({image.sensor for image in images})
    known = ", ".join(map(repr, sensors))
    if sensor is None and len(sensors) > 1:
        raise SystemExit(
            f"{scene}: expected images of one sensor, got {known}; name one of them with --sensor"
        )
    if sensor is not None and images and sensor not in sensors:
        raise SystemExit(f"{scene}: no images of the sensor {sensor!r}, expected one of: {known}")
    return [image for image in images if sensor in (None, image.sensor)]


def groups(split: Path, sensor: str | None, views: int) -> list[Group]:
    """Every image of the split, in groups of one scene each; the last of a scene may be smaller."""
    found = []
    for scene in sorted(split.glob("[0-9]*")):
        images = [image.number for image in images_of(scene, sensor)]
        found += [
            [(int(scene.name), image) for image in images[i : i + views]]
            for i in range(0, len(images), views)
        ]
    return found


def claim(out: Path, job: dict[str, Any]) -> None:
    """Refuses a folder in which another job has left its shards."""
    recipe = out / "job.json"
    if recipe.exists():
        if (before := json.loads(recipe.read_text())) != job:
            raise SystemExit(f"{out} holds the shards of another job, {before}; give another --out")
        return
    (out / "shards").mkdir(parents=True, exist_ok=True)
    partial = recipe.with_suffix(".partial")
    partial.write_text(json.dumps(job))
    os.replace(partial, recipe)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--data", required=True, type=Path, help="folder of the BOP data set")
    parser.add_argument("--split", required=True)
    parser.add_argument(
        "--sensor",
        metavar="CAM",
        help="CAM of scene_camera_CAM.json; '' of scene_camera.json [default: the only one]",
    )
    parser.add_argument("--model", required=True, type=Path, help="model bundle")
    parser.add_argument("--out", required=True, type=Path)
    parser.add_argument("--views", type=int, default=2, help="images per prediction")
    parser.add_argument("--shard-size", type=int, default=100, help="predictions per shard")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--threads", type=int, default=1, help="of the network in each worker")
    args = parser.parse_args()

    split = args.data / args.split
    if not split.is_dir():
        raise SystemExit(f"{split}: expected the folder of a split, found none")
    all_groups = groups(split, args.sensor, args.views)
    data, model, out = (str(path.resolve()) for path in (args.data, args.model, args.out))
    claim(
        args.out,
        {
            "data": data,
            "split": args.split,
            "sensor": args.sensor,
            "model": json.loads((args.model / "model.json").read_text())["files"],
            "views": args.views,
            "shard_size": args.shard_size,
            "predictions": len(all_groups),
        },
    )
    shards = [
        all_groups[i : i + args.shard_size] for i in range(0, len(all_groups), args.shard_size)
    ]
    files = [args.out / "shards" / f"{number:05}.csv" for number in range(len(shards))]
    missing = [number for number, file in enumerate(files) if not file.exists()]
    print(f"{len(all_groups)} predictions, {len(missing)} of {len(shards)} shards to do")

    if missing:
        ray.init(ignore_reinit_error=True)
        # One block per shard: what Ray repeats when a worker is lost is whole shards.
        work = ray.data.from_items(
            [{"shard": number, "groups": json.dumps(shards[number])} for number in missing],
            override_num_blocks=len(missing),
        ).map(
            Predict,
            fn_constructor_args=(data, args.split, args.sensor, model, out, args.threads),
            compute=ray.data.ActorPoolStrategy(size=args.workers),
            num_cpus=args.threads,
        )
        for done in work.iter_rows():
            print(f"shard {done['shard']}: {done['rows']} poses", flush=True)

    lost = [str(file) for file in files if not file.exists()]
    if lost:
        sys.exit(f"not written: {', '.join(lost)}; repeat the command")
    partial = args.out / "results.partial"
    with open(partial, "w", encoding="utf-8") as results:
        results.write(mvtop.BOP_RESULTS_HEADER)
        header = mvtop.BOP_RESULTS_HEADER
        results.writelines(file.read_text().removeprefix(header) for file in files)
    os.replace(partial, args.out / "results.csv")
    for left in (args.out / "shards").glob("*.partial"):  # by workers that were lost
        left.unlink()
    print(f"{args.out / 'results.csv'}")


if __name__ == "__main__":
    main()

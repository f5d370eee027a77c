"""Generate scenes in BOP layout: MV-ball, or your own part through your own rig.

    python -m mvtop_train.generate --out data/mvball --scenes 3000 --seed 1 --workers 2
    python -m mvtop_train.generate --out data/mvball --paper --split train easy hard
    python -m mvtop_train.generate --out data/part --mesh part.obj --mesh-unit mm --rig rig.json

Every scene is drawn from (seed, split, scene number) alone, so that a run can be stopped, split
into shards and resumed without changing the data. Scenes that are whole are left as they are. See
docs/data.md.
"""

import argparse
import contextlib
import dataclasses
import hashlib
import json
import multiprocessing
import os
import signal
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tqdm import tqdm

from . import mvball
from .objects import UNITS

# Splits draw from different random streams: no test scene can be a training scene.
# Control splits show both hemispheres in every view: there, one view determines the pose.
SPLITS = {"train": 0, "easy": 1, "hard": 2, "control": 3, "control_test": 4, "test": 5}
# Visible pixels of the hemisphere, paper.
MIN_PIXELS = {"train": 10, "easy": 300, "hard": 10, "control": 10, "control_test": 10, "test": 10}
PAPER_IMAGES = {"train": 112_042, "easy": 3_853, "hard": 3_458}


def open_gl():
    """One GL context per process; says what to install where there is none."""
    if "torch" in sys.modules:
        # Software GL and Triton, which torch loads when it likes, each bring an LLVM; the process
        # crashes if Triton's comes second.
        with contextlib.suppress(ImportError):
            import triton  # noqa: F401
    try:
        import mujoco

        return mujoco.GLContext(640, 480)
    except Exception as error:
        raise SystemExit(
            f"error: no off-screen OpenGL ({type(error).__name__}: {error}); "
            "fix: apt-get install libegl1 libgl1-mesa-dri, or set MUJOCO_GL=osmesa"
        ) from None


def hemispheres(split: str, index: int, views: int) -> list[str]:
    """What each view of scene `index` shows."""
    if split.startswith("control"):
        return ["both"] * views
    return [("green", "red")[(index + i) % 2] for i in range(views)]


def scene_views(gl, seed: int, split: str, index: int, order: list[str], size=(640, 480)):
    """The views of scene `index`: drops scenes until one shows every hemisphere of `order`."""
    from . import scenes

    textures = np.random.default_rng([seed, SPLITS[split], index // 50, 7])
    pool = [scenes.noise_texture(textures) for _ in range(12)]
    rng = np.random.default_rng([seed, SPLITS[split], index])
    while True:
        views = scenes.views_of_scene(rng, gl, pool, order, MIN_PIXELS[split], size)
        if views:
            return views


@dataclass(frozen=True)
class Recipe:
    """All that decides what a split looks like; kept beside its scenes."""

    seed: int
    split: str
    size: tuple[int, int]  # of MV-ball's images, px; of a rig's: the largest width, and 0
    mesh: str | None = None
    mesh_unit: str = "m"
    name: str = mvball.NAME
    rig: str | None = None
    source: str = ""  # digest of the mesh, its unit and the rig

    def check(self, folder: Path):
        """Refuse to add scenes to those of another recipe."""
        mine = {"seed": self.seed, "size": list(self.size), "name": self.name}
        mine["source"] = self.source
        path = folder / "recipe.json"
        found = json.loads(path.read_text()) if path.exists() else mine
        differs = [key for key in mine if found.get(key) != mine[key]]
        if differs:
            key = differs[0]
            raise SystemExit(
                f"error: {folder} was made with {key} {found.get(key)!r}, got {mine[key]!r}; "
                "fix: another --out"
            )
        folder.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(mine) + "\n")


def views_per_scene(images: int, views: int) -> list[int]:
    """How many images each scene gets; none is left with a single one, which has no partner."""
    counts = [views] * (images // views)
    rest = images % views
    if rest == 1 and counts:
        counts[-1] += 1
    elif rest:
        counts.append(rest)
    return counts


def _ball_work(job):
    recipe, out, tasks, queue = job
    from . import bop, objects

    gl, ball = open_gl(), objects.ball()
    for number, views in while_asked_for(tasks):
        folder = Path(out) / recipe.split / f"{number:06d}"
        if not bop.is_whole(folder):
            order = hemispheres(recipe.split, number, views)
            found = scene_views(gl, recipe.seed, recipe.split, number, order, recipe.size)
            bop.write_scene(folder, found, ball)
        queue.put(number)


def _part_work(job):
    recipe, out, tasks, queue = job
    from . import bop, objects, parts, rig, scenes

    mesh = objects.load_mesh(recipe.mesh, recipe.mesh_unit)
    part = parts.Part(mesh, objects.from_mesh(mesh, 1, recipe.name))
    cameras = [camera.at_width(recipe.size[0]) for camera in rig.load(recipe.rig)]
    gl = open_gl()
    for number, _ in while_asked_for(tasks):
        folder = Path(out) / recipe.split / f"{number:06d}"
        if not bop.is_whole(folder):
            rng = np.random.default_rng([recipe.seed, SPLITS[recipe.split], number])
            pool = [scenes.noise_texture(rng) for _ in range(6)]
            views, names = parts.scene_views(gl, rng, pool, part, cameras)
            bop.write_scene(folder, views, part.obj, names)
        queue.put(number)


def while_asked_for(tasks):
    """The tasks, until the process that gave them has been killed."""
    parent = multiprocessing.parent_process()
    for task in tasks:
        if parent is not None and not parent.is_alive():
            return
        yield task


def _ignore_interrupt():
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent stops its workers


def _guarded(call):
    """A worker's `SystemExit` as text: the pool would wait for ever for a process that exits."""
    work, job = call
    try:
        work(job)
    except SystemExit as error:
        return str(error)


def run_workers(work, tasks, workers: int, job_of, bar: tqdm):
    """Run `work(job_of(part of tasks, queue))` in processes; each puts a number per task done.

    Processes are spawned: a GL context does not survive a fork.
    """
    context = multiprocessing.get_context("spawn")
    workers = max(1, min(workers, len(tasks)))
    # The manager outlives the pool, whose workers write to its queue.
    with context.Manager() as manager, context.Pool(workers, _ignore_interrupt) as pool, bar:
        queue = manager.Queue()
        jobs = [(work, job_of(list(tasks[i::workers]), queue)) for i in range(workers)]
        result = pool.map_async(_guarded, jobs, chunksize=1)
        while not result.ready() or not queue.empty():
            result.wait(0.2)
            while not queue.empty():
                queue.get()
                bar.update()
        messages = [message for message in result.get() if message]  # raises what a worker raised
    if messages:
        raise SystemExit(messages[0])


def parse_shard(text: str) -> tuple[int, int]:
    try:
        shard, shards = (int(part) for part in text.split("/"))
    except ValueError:
        shard, shards = -1, 0
    if not 0 <= shard < shards:
        raise SystemExit(
            f"error: --shard: expected I/N with 0 <= I < N, got {text!r}; fix: 0/4, 1/4, ..."
        )
    return shard, shards


def prepare(args) -> tuple[Recipe, object]:
    """The recipe without its split, and the worker; writes `models/`."""
    from . import objects, parts, rig

    out = Path(args.out)
    if not args.mesh:
        objects.write(out, objects.ball(), objects.ball_mesh())
        size = (640, 480) if args.window is None else (args.window, args.window)
        return Recipe(args.seed, "", size), _ball_work
    if len(args.mesh) > 1:
        raise SystemExit(
            f"error: --mesh: expected one part, got {len(args.mesh)}; fix: one data set for each, "
            "as a network of several classes is not supported yet"
        )
    for name in ("rig", "mesh_unit"):
        if getattr(args, name) is None:
            option = name.replace("_", "-")
            raise SystemExit(f"error: --{option}: expected with --mesh, got none; fix: add it")
    mesh = objects.load_mesh(args.mesh[0], args.mesh_unit)
    part = objects.from_mesh(mesh, 1, args.name or Path(args.mesh[0]).stem)
    parts.Part(mesh, part)  # refuses what cannot fall
    cameras = rig.load(args.rig)
    parts.check_rig(cameras, part, args.rig)
    bent = [camera.id for camera in cameras if camera.distorted]
    if bent:
        print(f"note: images of {', '.join(bent)} are rendered without lens distortion, as "
              "undistorted images with the same fx, fy, cx, cy would be")  # fmt: skip
    offset = abs(mesh.bounds.mean(0)).max()
    if offset > 0.2 * part.diameter_m:
        print(f"note: the mesh's origin is {offset * 1e3:.0f} mm off its middle; poses are of "
              "this origin, but are learnt better if it is inside the part")  # fmt: skip
    objects.write(out, part, mesh)
    unit = args.mesh_unit
    content = Path(args.mesh[0]).read_bytes() + unit.encode() + Path(args.rig).read_bytes()
    source = hashlib.sha256(content).hexdigest()[:16]
    recipe = Recipe(
        args.seed, "", (args.width, 0), args.mesh[0], unit, part.name, str(args.rig), source
    )
    return recipe, _part_work


def make_split(recipe: Recipe, work, args, shard: int, shards: int):
    from . import pairs

    images = PAPER_IMAGES.get(recipe.split) if args.paper else args.images
    if args.paper and images is None:
        raise SystemExit(
            f"error: --paper: expected a split of {list(PAPER_IMAGES)}, got {recipe.split!r}; "
            "fix: --images"
        )
    counts = views_per_scene(images, args.views) if images else [args.views] * args.scenes
    folder = Path(args.out) / recipe.split
    recipe.check(folder)
    run_workers(
        work,
        list(enumerate(counts))[shard::shards],
        args.workers,
        lambda part, queue: (recipe, args.out, part, queue),
        tqdm(total=len(counts[shard::shards]), unit="scene", smoothing=0.05, desc=recipe.split),
    )
    scenes, images, pair_count = pairs.write(folder)
    print(f"{folder}: {images} images in {scenes} scenes, {pair_count} pairs")


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", default="data/mvball", help="dataset folder")
    parser.add_argument("--split", choices=SPLITS, default=["train"], nargs="+")
    size = parser.add_mutually_exclusive_group()
    size.add_argument("--scenes", type=int, default=3000)
    size.add_argument("--images", type=int, help="as many images, instead of scenes")
    size.add_argument("--paper", action="store_true", help="as many images as the paper's split")
    parser.add_argument("--views", type=int, default=6, help="images per scene of MV-ball")
    parser.add_argument(
        "--window", type=int, metavar="PX", help="render only a window around the ball (faster)"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--shard", default="0/1", metavar="I/N", help="do scenes I, I+N, ...")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    own = parser.add_argument_group("your own part")
    own.add_argument("--mesh", action="append", help="obj, stl or ply file")
    own.add_argument("--mesh-unit", choices=UNITS, help="of the mesh file")
    own.add_argument("--name", help="of the part; the mesh's file name if left out")
    own.add_argument("--rig", help="rig.json: the cameras that will look at the part")
    own.add_argument("--width", type=int, default=640, help="of the images at most, px")
    args = parser.parse_args()
    shard, shards = parse_shard(args.shard)
    for option in ("scenes", "images", "views", "workers", "width"):
        if getattr(args, option) is not None and getattr(args, option) < 1:
            raise SystemExit(
                f"error: --{option}: expected at least 1, got {getattr(args, option)}; "
                "fix: leave it out"
            )
    recipe, work = prepare(args)
    try:
        for split in args.split:
            make_split(dataclasses.replace(recipe, split=split), work, args, shard, shards)
    except KeyboardInterrupt:
        raise SystemExit("stopped; the same command goes on from here") from None


if __name__ == "__main__":
    main()

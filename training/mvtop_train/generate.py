"""Generate MV-ball-like scenes in BOP layout.

    python -m mvtop_train.generate --out data/mvball --scenes 3000 --seed 1 --workers 2

Every scene is drawn from (seed, split, scene number) alone, so that a run can be stopped, split
into shards and resumed without changing the data. Scenes that are whole are left as they are.
"""

import argparse
import contextlib
import multiprocessing
import os
import sys
from pathlib import Path

import numpy as np
from tqdm import tqdm

# Both are read when MuJoCo or the GL library load, so they come before any of its imports.
os.environ.setdefault("MUJOCO_GL", "egl")
os.environ.setdefault("LP_NUM_THREADS", "1")  # software rendering: one core per process

# Splits draw from different random streams: no test scene can be a training scene.
# Control splits show both hemispheres in every view: there, one view determines the pose.
SPLITS = {"train": 0, "easy": 1, "hard": 2, "control": 3, "control_test": 4}
# Visible pixels of the hemisphere, paper.
MIN_PIXELS = {"train": 10, "easy": 300, "hard": 10, "control": 10, "control_test": 10}


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


def _work(job):
    out, seed, split, numbers, views, size, queue = job
    from . import bop, objects

    gl, ball = open_gl(), objects.ball()
    for number in numbers:
        folder = Path(out) / split / f"{number:06d}"
        if not bop.is_whole(folder):
            order = hemispheres(split, number, views)
            bop.write_scene(folder, scene_views(gl, seed, split, number, order, size), ball)
        queue.put(number)


def run_workers(work, numbers, workers: int, job_of, bar: tqdm):
    """Run `work(job_of(part of numbers, queue))` in processes; each puts a number when it is done.

    Processes are spawned: a GL context does not survive a fork.
    """
    context = multiprocessing.get_context("spawn")
    queue = context.Manager().Queue()
    jobs = [job_of(list(numbers[i::workers]), queue) for i in range(workers)]
    with context.Pool(workers) as pool, bar:
        result = pool.map_async(work, jobs)
        while not result.ready() or not queue.empty():
            result.wait(0.2)
            while not queue.empty():
                queue.get()
                bar.update()
        result.get()  # raises what a worker raised


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", default="data/mvball", help="dataset folder")
    parser.add_argument("--split", choices=SPLITS, default="train")
    parser.add_argument("--scenes", type=int, default=3000)
    parser.add_argument("--views", type=int, default=6, help="images per scene")
    parser.add_argument(
        "--window", type=int, metavar="PX", help="render only a window around the ball (faster)"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--shard", default="0/1", metavar="I/N", help="do scenes I, I+N, ...")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    args = parser.parse_args()
    shard, shards = (int(part) for part in args.shard.split("/"))
    size = (640, 480) if args.window is None else (args.window, args.window)
    from . import objects

    objects.write(Path(args.out), objects.ball(), objects.ball_mesh())
    numbers = range(shard, args.scenes, shards)
    run_workers(
        _work,
        numbers,
        args.workers,
        lambda part, queue: (args.out, args.seed, args.split, part, args.views, size, queue),
        tqdm(total=len(numbers), unit="scene", smoothing=0.05),
    )


if __name__ == "__main__":
    main()

"""Time our metrics and the BOP toolkit's side by side, on the same poses of the same points.

    git clone https://github.com/thodan/bop_toolkit
    cargo build --release -p mvtop-benches --bin metrics_speed
    PYTHONPATH=training:bop_toolkit python benches/metrics_speed.py

Each function is called once per pose, round after round, ours and theirs in turn, so that both see
the machine in the same state; the least time of all rounds counts, as other work can only add to
it. Values are compared on the way. Both sides use one thread.
"""

import argparse
import json
import os
import subprocess
import tempfile
import time
from pathlib import Path

for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[threads] = "1"

import numpy as np  # noqa: E402 (after the threads)
import result_file  # noqa: E402
from mvtop_train.errors import UserError, command  # noqa: E402
from mvtop_train.export.fixtures.metrics import Rendered, parts, pose, rotation  # noqa: E402
from safetensors.numpy import save_file  # noqa: E402

SEED = 5
POSES = 4
# (width, height) of the depth images for VSD.
SIZE = (640, 480)


def scene(points, rng):
    """A body of revolution of `points` vertices; poses near to and far from the truth."""
    directions = rng.normal(size=(points, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    pts = directions * [60, 60, 90] * (1 + 0.2 * np.sin(5 * directions[:, 2:]))
    truth, estimate = [], []
    for degrees, mm in [(2, 2), (10, 10), (60, 40), (180, 200)][:POSES]:
        true = pose(rotation(rng), [*rng.uniform(-100, 100, 2), rng.uniform(700, 1000)])
        truth.append(true)
        estimate.append(true @ pose(rotation(rng, degrees), rng.uniform(-mm, mm, 3)))
    return pts, np.array(truth), np.array(estimate)


def depth_images(truth, estimate, lens):
    """Spheres in the poses' places: VSD sees depth images, whatever they are of."""
    width, height = SIZE
    fx, fy, cx, cy = lens
    x = (np.arange(width)[None] - cx) / fx
    y = (np.arange(height)[:, None] - cy) / fy
    a = x * x + y * y + 1

    def sphere(center):
        b = x * center[0] + y * center[1] + center[2]
        root = b * b - a * (center @ center - 80.0**2)
        return np.where(root > 0, (b - np.sqrt(np.maximum(root, 0))) / a, 0).astype(np.float32)

    images = [[sphere(motion[:3, 3]) for motion in motions] for motions in (truth, estimate)]
    return np.array(images[0]), np.array(images[1])


def toolkit(pts, truth, estimate, lens, depth_truth, depth_estimate):
    """Name to function of the pose's number."""
    from bop_toolkit_lib import misc, pose_error

    info = {"symmetries_continuous": [{"axis": [0, 0, 1], "offset": [0, 0, 0]}]}
    none = misc.get_symmetry_transformations({}, 0.01)
    turns = misc.get_symmetry_transformations(info, 0.01)
    k = np.array([[lens[0], 0, lens[2]], [0, lens[1], lens[3]], [0, 0, 1]])
    measured = np.full(SIZE[::-1], 1500, np.float32)
    taus = list(np.arange(0.05, 0.51, 0.05))

    def both(i):
        return *parts(estimate[i]), *parts(truth[i])

    def vsd(i):
        renderer = Rendered([depth_estimate[i], depth_truth[i]])
        return np.mean(
            pose_error.vsd(*both(i), measured, k, 15.0, taus, True, 180.0, renderer, 1, "step")
        )

    return {
        "add": lambda i: pose_error.add(*both(i), pts),
        "adi": lambda i: pose_error.adi(*both(i), pts),
        "mssd": lambda i: pose_error.mssd(*both(i), pts, none),
        "mssd_turns": lambda i: pose_error.mssd(*both(i), pts, turns),
        "mspd": lambda i: pose_error.mspd(*both(i), k, pts, none),
        "mspd_turns": lambda i: pose_error.mspd(*both(i), k, pts, turns),
        "vsd": vsd,
    }


@command
def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, help="write a result for benches/results")
    parser.add_argument("--points", type=int, default=5000)
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--program", default="target/release/metrics_speed")
    args = parser.parse_args()
    rng = np.random.default_rng(SEED)
    pts, truth, estimate = scene(args.points, rng)
    lens = np.array([700.0, 700.0, 320.0, 240.0])
    depth_truth, depth_estimate = depth_images(truth, estimate, lens)
    functions = toolkit(pts, truth, estimate, lens, depth_truth, depth_estimate)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.safetensors"
        tensors = {"points": pts, "truth": truth, "estimate": estimate, "lens": lens}
        tensors |= {"depth_truth": depth_truth, "depth_estimate": depth_estimate}
        save_file({name: np.ascontiguousarray(t) for name, t in tensors.items()}, path)
        theirs = {name: np.full(POSES, np.inf) for name in functions}
        ours = {name: np.full(POSES, np.inf) for name in functions}
        for _ in range(args.rounds):
            lines = subprocess.run(
                [args.program, str(path)], check=True, capture_output=True, text=True
            ).stdout.splitlines()
            for line in map(json.loads, lines):
                name, i = line["name"], line["pose"]
                ours[name][i] = min(ours[name][i], line["us"])
                begin = time.perf_counter()
                value = functions[name](i)
                theirs[name][i] = min(theirs[name][i], 1e6 * (time.perf_counter() - begin))
                if abs(value - line["value"]) > 1e-6:
                    raise UserError(f"{name} {i}: theirs {value}, ours {line['value']}")
    if args.json:
        columns = ["µs per pose", "bop_toolkit", "mvtop"]
        rows = [[n, f"{theirs[n].mean():.0f}", f"{ours[n].mean():.1f}"] for n in functions]
        result_file.write(args.json, "Metrics", SEED, columns, rows)
    print(f"{args.points} points, {POSES} poses, least of {args.rounds} rounds, us per pose")
    print("| error | bop_toolkit | mvtop | times as fast (pose by pose) |\n|---|---|---|---|")
    for name in functions:
        ratios = ", ".join(f"{r:.0f}" for r in theirs[name] / ours[name])
        print(f"| {name} | {theirs[name].mean():.0f} | {ours[name].mean():.1f} | {ratios} |")


if __name__ == "__main__":
    main()

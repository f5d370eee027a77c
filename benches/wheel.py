"""What the wheel costs, with it installed, and how long a first pose takes.

    python benches/wheel.py target/wheels/mvtop-*.whl target/release/mvtop-cli

Prints its size, the time of `import mvtop` beside that of numpy, onnxruntime and an empty program,
that of `mvtop-cli infer` on the example, from its start to its end, and how much longer `predict`
takes than the stages that the core measures.
"""

import statistics
import subprocess
import sys
import time
from pathlib import Path

import mvtop

ROOT = Path(__file__).resolve().parents[1]
RUNS = 15


def seconds(*command: str) -> float:
    start = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - start


def main() -> None:
    if len(sys.argv) > 1:
        print(f"wheel: {Path(sys.argv[1]).stat().st_size / 1e6:.2f} MB")

    imports = ["pass", "import mvtop", "import numpy", "import onnxruntime"]
    commands = {f"python -c '{script}'": [sys.executable, "-c", script] for script in imports}
    if len(sys.argv) > 2:
        example = ROOT / "examples/mvball"
        files = [str(example / name) for name in ("rig.json", "cam0.png", "cam1.png")]
        commands["mvtop-cli infer"] = [sys.argv[2], "infer", "--rig", *files]
    times: dict[str, list[float]] = {name: [] for name in commands}
    for _ in range(RUNS):  # side by side: other jobs disturb all alike
        for name, command in commands.items():
            times[name].append(seconds(*command))
    for name, taken in times.items():
        print(
            f"{name}: least {1e3 * min(taken):.0f} ms, "
            f"median {1e3 * statistics.median(taken):.0f} ms"
        )

    rig = mvtop.Rig.load(ROOT / "examples/mvball/rig.json")
    estimator = mvtop.Estimator.load(ROOT / "models/mvball")
    paths = [ROOT / f"examples/mvball/{camera.id}.png" for camera in rig.cameras]
    arrays = estimator._native.images(rig, list(enumerate(paths)))
    for name, images in [("arrays", arrays), ("paths", paths)]:
        more, total = [], []
        for _ in range(RUNS):
            start = time.perf_counter()
            prediction = estimator.predict(images, rig)
            wall = 1e3 * (time.perf_counter() - start)
            total.append(prediction.timings_ms["total"])
            more.append(wall - total[-1])
        print(
            f"predict from {name}: core {statistics.median(total):.0f} ms, "
            f"beside it {statistics.median(more):.2f} ms (medians of {RUNS})"
        )


if __name__ == "__main__":
    main()

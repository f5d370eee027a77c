"""What the wheel costs: python benches/wheel.py target/wheels/mvtop-*.whl, with it installed.

Prints its size, the time of `import mvtop` beside that of numpy, onnxruntime and an empty program,
and how much longer `predict` takes than the stages that the core measures.
"""

import statistics
import subprocess
import sys
import time
from pathlib import Path

import mvtop

ROOT = Path(__file__).resolve().parents[1]
RUNS = 15


def seconds(script: str) -> float:
    start = time.perf_counter()
    subprocess.run([sys.executable, "-c", script], check=True)
    return time.perf_counter() - start


def main() -> None:
    if len(sys.argv) > 1:
        print(f"wheel: {Path(sys.argv[1]).stat().st_size / 1e6:.2f} MB")

    imports = ["pass", "import mvtop", "import numpy", "import onnxruntime"]
    times: dict[str, list[float]] = {script: [] for script in imports}
    for _ in range(RUNS):  # side by side: other jobs disturb all alike
        for script in imports:
            times[script].append(seconds(script))
    for script in imports:
        print(
            f"python -c '{script}': least {1e3 * min(times[script]):.0f} ms, "
            f"median {1e3 * statistics.median(times[script]):.0f} ms"
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

"""One case of `predict.py` in a process of its own.

    python benches/predict_worker.py BUNDLE CLASSES ROUNDS THREADS SCENE...

Predicts each scene once to warm up, then all of them in turn, and prints a line of JSON.
"""

import json
import re
import sys
from pathlib import Path

import numpy as np

import mvtop


def main():
    bundle, (classes, rounds, threads) = sys.argv[1], map(int, sys.argv[2:5])
    estimator = mvtop.Estimator.load(bundle, threads=threads)
    names = [one.name for one in estimator.classes]
    request = mvtop.Request(classes=names[:classes]) if classes < len(names) else None
    scenes = []
    for folder in map(Path, sys.argv[5:]):
        with np.load(folder / "images.npz") as file:
            scenes.append((dict(file), mvtop.Rig.load(folder / "rig.json")))

    def predict(images, rig):
        return estimator.predict(images, rig, request=request)

    found = sum(len(predict(*scene)) for scene in scenes)
    rows = [predict(*scene).timings_ms for _ in range(rounds) for scene in scenes]
    rows = [{name: float(ms) for name, ms in dict(row).items()} for row in rows]
    # Not `ru_maxrss`, which begins at that of the process that started this one.
    peak = int(re.search(r"VmHWM:\s+(\d+)", Path("/proc/self/status").read_text())[1]) / 1024
    print(json.dumps({"found": found, "rows": rows, "peak_mb": peak}))


if __name__ == "__main__":
    main()

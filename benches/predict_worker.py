"""One case of `predict.py` in a process of its own.

    python benches/predict_worker.py BUNDLE CLASSES ROUNDS CORES CALLERS SCENE...

Predicts each scene once to warm up, then all of them in turn, then those of several cameras with a
tracker to which one image is new, and prints a line of JSON. `first_crop` has the times of crops of
detected boxes alone, which are of one image each; other crops follow from poses of all images.
`per_second` has the predictions a second of 1, 2, 4 and so on to CALLERS threads that ask at once.
"""

import json
import os
import re
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np


def flat(timings) -> dict[str, float]:
    return {name: float(ms) for name, ms in dict(timings).items()}


def main():
    bundle, (classes, rounds, cores, callers) = sys.argv[1], map(int, sys.argv[2:6])
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:cores])
    import mvtop  # now, as it starts a thread on each core

    estimator = mvtop.Estimator.load(bundle, threads=cores)
    names = [one.name for one in estimator.classes]
    request = mvtop.Request(classes=names[:classes]) if classes < len(names) else None
    scenes = []
    for folder in map(Path, sys.argv[6:]):
        with np.load(folder / "images.npz") as file:
            scenes.append((dict(file), mvtop.Rig.load(folder / "rig.json")))

    def predict(images, rig):
        return estimator.predict(images, rig, request=request)

    found = sum(len(predict(*scene)) for scene in scenes)
    rows = [flat(predict(*scene).timings_ms) for _ in range(rounds) for scene in scenes]
    # Not `ru_maxrss`, which begins at that of the process that started this one.
    peak = int(re.search(r"VmHWM:\s+(\d+)", Path("/proc/self/status").read_text())[1]) / 1024
    per_second = {}
    for count in (2**n for n in range(callers.bit_length())):
        asked = scenes * rounds * count
        with ThreadPoolExecutor(count) as threads:
            begun = time.perf_counter()
            list(threads.map(lambda scene: predict(*scene), asked))
            per_second[count] = len(asked) / (time.perf_counter() - begun)
    tracked, first_crop = [], []
    several = scenes if len(scenes[0][0]) > 1 else ()
    detected = {"search.schedule": [], "search.doubtful": 0.0}  # crops of detected boxes alone
    first = mvtop.Estimator.load(bundle, threads=cores, inference=detected)
    for images, rig in several:
        times = [first.predict(images, rig, request=request).timings_ms for _ in range(rounds)]
        first_crop += [flat(one)["crop"] for one in times]
    for images, rig in several:
        tracker = mvtop.Tracker(estimator, rig)
        tracker.update(images)
        tracker.predict(request=request)
        camera, image = next(iter(images.items()))
        for _ in range(rounds):
            image = image ^ 1  # another image that shows the same
            tracker.update({camera: image})
            tracked.append(flat(tracker.predict(request=request).timings_ms)["total"])
    more = {"tracked": tracked, "first_crop": first_crop, "per_second": per_second}
    print(json.dumps({"found": found, "rows": rows, "peak_mb": peak} | more))


if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""Many predictions, reloads, kills and resumes: memory stays flat, results stay equal bit by bit.

    make soak                    # 10,000 predictions, 20 evaluations, each killed some times
    make soak PREDICTIONS=100000 KILLED=200

Uses the small network of the tests, whose boxes are given, as what is tested is everything around
it. Ends with an error at the first result that differs, or where memory has grown.
"""

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

import mvtop

ROOT = Path(__file__).parents[1]
TINY = ROOT / "fixtures/tiny"
THREADS = 4
RELOAD = 250  # predictions of an estimator, then it is loaded anew
WARM = 0.2  # of all predictions, before memory is looked at
GROWTH_MB = 16.0  # from then on, at most
SCENES = 40  # of the data set that evaluations are killed on


def resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def answer(estimator, images, rig) -> str:
    """All of a prediction but how long it took."""
    found = estimator.predict(images, rig, boxes=TINY / "sample/truth.json").to_dict()
    del found["timings_ms"]
    return json.dumps(found)


def cases(rig):
    """Images and the rig of each: the sample's, and the same with noise, of some of its cameras."""
    import cv2

    rng, paths = np.random.default_rng(0), [TINY / f"sample/{c.id}.png" for c in rig.cameras]
    whole = {c.id: cv2.imread(str(p))[:, :, ::-1] for c, p in zip(rig.cameras, paths, strict=True)}
    for views in range(1, len(whole) + 1):
        for strength in (0, 10, 40):
            chosen = list(whole.items())[:views]
            yield {
                name: np.clip(image + rng.normal(0, strength, image.shape), 0, 255).astype(np.uint8)
                for name, image in chosen
            }


def predict(count: int):
    """`count` predictions by threads that share an estimator, which is loaded anew at times."""
    rig = mvtop.Rig.load(TINY / "sample/rig.json")
    images = list(cases(rig))
    fresh = mvtop.Estimator.load(TINY, threads=1)
    expected = [answer(fresh, one, rig) for one in images]
    shared = {"estimator": fresh, "done": 0, "loads": 1, "wrong": None, "memory": []}
    lock, begun = threading.Lock(), time.monotonic()

    def estimator_for(number: int):
        if number % RELOAD == RELOAD - 1:
            # The number of threads is to change nothing.
            threads = 1 + shared["loads"] % 2
            shared["estimator"] = mvtop.Estimator.load(TINY, threads=threads)
            shared["loads"] += 1
        if number % max(1, count // 20) == 0:
            shared["memory"].append((number, resident_mb()))
        return shared["estimator"]

    def work():
        while shared["wrong"] is None:
            with lock:
                number = shared["done"]
                if number >= count:
                    return
                shared["done"] += 1
            case = number % len(images)
            try:
                with lock:
                    estimator = estimator_for(number)
                got = answer(estimator, images[case], rig)
            except Exception as error:  # a thread's own is lost
                got = repr(error)
            if got != expected[case]:
                shared["wrong"] = f"prediction {number}: expected {expected[case]}, got {got}"

    workers = [threading.Thread(target=work) for _ in range(THREADS)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    if shared["wrong"]:
        sys.exit(shared["wrong"])
    minutes = (time.monotonic() - begun) / 60
    memory = [*shared["memory"], (count, resident_mb())]
    warm = [mb for number, mb in memory if number >= WARM * count]
    print(
        f"{count} predictions of {len(images)} kinds, {THREADS} threads, {shared['loads']} loads, "
        f"{minutes:.1f} min: all equal; resident {warm[0]:.0f} MB after {WARM:.0%}, at most "
        f"{max(warm):.0f}, {warm[-1]:.0f} MB at the end",
        flush=True,
    )
    if max(warm) - warm[0] > GROWTH_MB:
        sys.exit(f"memory: expected growth of {GROWTH_MB} MB at most, got {memory}")


def write_data(folder: Path):
    """The sample as a data set in BOP's layout, many times."""
    rig = mvtop.Rig.load(TINY / "sample/rig.json")
    truth = json.loads((TINY / "sample/truth.json").read_text())["objects"][0]
    world_from_obj = np.array(truth["T_world_obj"])
    cameras, poses, boxes = {}, {}, {}
    for number, camera in enumerate(rig.cameras):
        cam_from_world = np.linalg.inv(np.array(camera.world_from_cam))
        cam_from_obj = cam_from_world @ world_from_obj
        x0, y0, x1, y1 = truth["boxes"][camera.id]

        def placed(pose, end):
            rotation, place = pose[:3, :3].ravel().tolist(), (pose[:3, 3] * 1e3).tolist()
            return {f"cam_R_{end}": rotation, f"cam_t_{end}": place}

        k = np.array(camera.K).ravel().tolist()
        cameras[number] = {"cam_K": k, "depth_scale": 1.0, **placed(cam_from_world, "w2c")}
        poses[number] = [{"obj_id": 1, **placed(cam_from_obj, "m2c")}]
        boxes[number] = [{"bbox_obj": [x0, y0, x1 - x0, y1 - y0]}]
    for number in range(SCENES):
        scene = folder / f"test/{number:06d}"
        (scene / "rgb").mkdir(parents=True)
        parts = (("camera", cameras), ("gt", poses), ("gt_info", boxes))
        for name, content in parts:
            (scene / f"scene_{name}.json").write_text(json.dumps(content))
        for n, camera in enumerate(rig.cameras):
            shutil.copy(TINY / f"sample/{camera.id}.png", scene / f"rgb/{n:06d}.png")
    (folder / "models").mkdir()
    about = {"1": {"diameter": 130.8, "name": "mvball"}}
    (folder / "models/models_info.json").write_text(json.dumps(about))
    points = "60 0 0\n-60 0 0\n0 60 0\n0 -60 0\n0 0 60\n0 0 -60\n"
    faces = "3 0 2 4\n3 2 1 4\n3 1 3 4\n3 3 0 4\n3 2 0 5\n3 1 2 5\n3 3 1 5\n3 0 3 5\n"
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    header = f"ply\nformat ascii 1.0\nelement vertex 6\n{axes}element face 8\n"
    header += "property list uchar int vertex_indices\nend_header\n"
    (folder / "models/obj_000001.ply").write_text(header + points + faces)


def results(out: Path) -> dict[str, str]:
    """What an evaluation found, without the times of it."""
    found = {}
    for path in sorted(out.glob("*.csv")):
        rows = [row.rpartition(",")[0] for row in path.read_text().splitlines()]
        found[path.name] = "\n".join(rows)
    if not found:
        sys.exit(f"{out}: expected a CSV, got none")
    return found


def kill(count: int):
    """`count` evaluations, each killed some times at random and gone on with."""
    draw, begun = random.Random(0), time.monotonic()
    with tempfile.TemporaryDirectory() as temporary:
        data = Path(temporary) / "data"
        write_data(data)

        def command(out: Path):
            run = "import sys; from mvtop._cli import main; sys.exit(main())"
            return [
                *(sys.executable, "-c", run),
                "eval",
                "bop",
                "--true-boxes",
                "--model",
                TINY,
                "--views",
                "2",
                "--dataset",
                data,
                "--out",
                out,
            ]

        whole = Path(temporary) / "whole"
        start = time.monotonic()
        subprocess.run(command(whole), check=True, capture_output=True)
        took, kills = time.monotonic() - start, 0
        expected = results(whole)
        for number in range(count):
            out = Path(temporary) / f"killed{number}"
            for attempt in range(100):
                with open(Path(temporary) / "log", "w") as log:
                    run = subprocess.Popen(command(out), stdout=log, stderr=log)
                try:
                    # The last attempts are left alone.
                    limit = None if attempt >= 4 else draw.uniform(0.05, 0.9) * took
                    code = run.wait(limit)
                except subprocess.TimeoutExpired:
                    run.send_signal(signal.SIGKILL)
                    run.wait()
                    kills += 1
                    continue
                if code:
                    sys.exit((Path(temporary) / "log").read_text())
                break
            if results(out) != expected:
                sys.exit(f"evaluation {number} differs from one that was not killed")
            shutil.rmtree(out)
    minutes = (time.monotonic() - begun) / 60
    print(
        f"{count} evaluations of {SCENES} scenes, killed {kills} times, {minutes:.1f} min: "
        "results equal those of one that was not killed",
        flush=True,
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--predictions", type=int, default=10_000)
    parser.add_argument("--killed", type=int, default=20, help="evaluations that are killed")
    args = parser.parse_args()
    predict(args.predictions)
    kill(args.killed)


if __name__ == "__main__":
    main()

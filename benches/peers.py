"""mvtop and other runtimes on the same network and the same images: time and memory.

    make bench-peers

Each contestant is a process of its own, which holds its network for all rounds; in each round every
one runs once, in another order each time, so that other work on the machine disturbs all alike:
ratios hold, times are of the machine. mvtop does everything from image arrays to the pose, given
the boxes; the others run the network alone on prepared tensors: the detector on whole images, the
close-ups, and the decoder once for each of the views with the largest boxes, at most four. "int8"
has its ranges from the same images. All poses must agree with PyTorch's in fp32 within TOLERANCE.
Contestants that are not installed, or not ready in time, are left out and named.
"""

import importlib.metadata
import importlib.util
import json
import os
import platform
import random
import selectors
import statistics
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import torch
from mvtop_train.data import objects
from mvtop_train.errors import UserError, argument_parser, command
from mvtop_train.export import bundle, reference
from mvtop_train.network import config as configs
from mvtop_train.network.model import Mvtop
from mvtop_train.training.checkpoint import load_weights
from peers_worker import CONTESTANTS, LIBRARY

ROOT = Path(__file__).resolve().parents[1]
EXAMPLE = ROOT / "examples/mvball"
# Degrees and millimetres by which a pose may differ from PyTorch's in fp32.
TOLERANCE = {"fp32": (0.05, 0.05), "bf16": (5.0, 5.0), "int8": (5.0, 5.0)}
REFERENCE = "PyTorch fp32"


def network(name: str) -> Mvtop:
    """Of a file of weights, or a preset with random ones."""
    if name not in configs.PRESETS:
        return load_weights(Path(name))[0]
    torch.manual_seed(0)
    known = objects.classes_of(objects.ball())
    return Mvtop(configs.preset(name, known)).eval()


def prepare(model: Mvtop, work: Path, views: int) -> None:
    """Bundles, and what the graphs are given, of the example's views, repeated under new names."""
    model = bundle.fold_batch_norm(model)
    torch.save(model, work / "model.pt")
    bundle.write_bundle(model, work / "bundle", {})
    bundle.write_bundle(model, work / "portable", {}, portable=True)
    rig = json.loads((EXAMPLE / "rig.json").read_text())
    truth = json.loads((EXAMPLE / "truth.json").read_text())["objects"][0]
    _, images, boxes, _ = reference.load_sample(EXAMPLE)
    count = len(images)
    ids = [f"view{view}" for view in range(views)]
    rig["cameras"] = [rig["cameras"][v % count] | {"id": i} for v, i in enumerate(ids)]
    rig["reference"] = ids[0]
    (work / "rig.json").write_text(json.dumps(rig))
    images = [np.ascontiguousarray(images[view % count]) for view in range(views)]
    boxes = [boxes[view % count] for view in range(views)]
    of_views = {i: box.tolist() for i, box in zip(ids, boxes, strict=True)}
    (work / "boxes.json").write_text(json.dumps({"class": truth["class"], "boxes": of_views}))
    np.savez(work / "images.npz", **dict(zip(ids, images, strict=True)))

    config, cameras = model.config, reference.load_rig(work / "rig.json")
    pictures = [reference.close_up(config, *of) for of in zip(cameras, images, boxes, strict=True)]
    given = {
        "images": np.stack([reference.image_tensor(config, rgb) for rgb in images]),
        "camera_rays": np.stack([picture.camera_rays for picture in pictures]),
        "pictures": np.stack([picture.tensor for picture in pictures]),
    }
    for anchor in range(views):
        inputs = reference.decoder_inputs(config, pictures, anchor)
        given |= {f"{anchor}.{name}": x.numpy() for name, x in inputs.items()}
    given["sizes"] = np.array([picture.extent for picture in pictures])
    given = {name: array.astype(np.float32) for name, array in given.items()}
    np.savez(work / "inputs.npz", **given)
    pictures_of = {"features": given["images"], "closeup": given["pictures"]}
    bundle.write_bundle(model, work / "integers", {}, pictures=pictures_of)
    world_from_cam = [picture.world_from_cam.tolist() for picture in pictures]
    (work / "cameras.json").write_text(json.dumps(world_from_cam))


class Worker:
    """A contestant's process."""

    def __init__(self, name: str, work: Path):
        script = [sys.executable, Path(__file__).with_name("peers_worker.py"), name, work]
        self.log = open(work / f"{name}.log", "w")
        self.process = subprocess.Popen(
            script, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self.log, text=True
        )
        self.ready = selectors.DefaultSelector()
        self.ready.register(self.process.stdout, selectors.EVENT_READ)

    def run(self, views: int, seconds: float | None = None) -> dict | None:
        """What it says; None where it ended or takes longer than this."""
        try:
            self.process.stdin.write(f"{views}\n")
            self.process.stdin.flush()
        except BrokenPipeError:
            return None
        line = self.process.stdout.readline() if self.ready.select(seconds) else ""
        return json.loads(line) if line else None

    def end(self):
        self.process.kill()
        self.process.wait()
        self.log.close()


def world_from_obj(poses: dict | list, cameras: list) -> np.ndarray:
    """[4, 4], of a contestant's answers by anchor, or mvtop's own pose in the world."""
    if isinstance(poses, list):
        return np.array(poses)
    found = []
    for anchor, answers in poses.items():
        decoded = {name: torch.tensor(x) for name, x in answers.items()}
        found += reference.hypotheses_of(decoded, np.array(cameras[int(anchor)]))
    return reference.most_probable(found)[0]


def difference(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """Degrees and millimetres between two poses."""
    # Of the chord, which is exact for small angles where the trace is not.
    chord = np.linalg.norm(a[:3, :3] - b[:3, :3]) / np.sqrt(8)
    degrees = np.degrees(2 * np.arcsin(min(1.0, chord)))
    return float(degrees), float(1e3 * np.linalg.norm(a[:3, 3] - b[:3, 3]))


def compare(work: Path, names: list[str], views: list[int], rounds: int, seconds: float) -> dict:
    """By contestant: times by number of views, peak memory, and distance to the reference."""
    cameras = json.loads((work / "cameras.json").read_text())
    workers, found, left_out = {}, {}, {}
    try:
        for name in names:
            worker = workers[name] = Worker(name, work)
            found[name] = {"ms": {v: [] for v in views}, "peak_mb": {}, "poses": {}}
            end = time.monotonic() + seconds
            for count in views:  # the first run of each number of views compiles and is not timed
                said = worker.run(count, max(0.0, end - time.monotonic()))
                if said is None:
                    break
                found[name]["peak_mb"][count] = said["peak_mb"]
                found[name]["poses"][count] = world_from_obj(said["poses"], cameras)
            else:
                continue
            workers.pop(name).end()
            del found[name]
            lines = (work / f"{name}.log").read_text().strip().splitlines()
            left_out[name] = lines[-1] if lines else f"not ready within {seconds:.0f} s"
        order = list(workers)
        for _ in range(rounds):
            random.shuffle(order)
            for count in views:
                for name in order:
                    said = workers[name].run(count)
                    if said is None:
                        raise UserError(f"{name}: ended while it was timed; see {work}/{name}.log")
                    found[name]["ms"][count].append(said["ms"])
    finally:
        for worker in workers.values():
            worker.end()
    if REFERENCE not in found:
        raise UserError(f"{REFERENCE}: expected its poses, got none: {left_out[REFERENCE]}")
    expected = found[REFERENCE]["poses"]
    gaps = {n: [difference(of["poses"][v], expected[v]) for v in views] for n, of in found.items()}
    for name, of in found.items():
        del of["poses"]
        kind = name.split()[-1]
        of["precision"] = kind if kind in TOLERANCE else "fp32"
        of["degrees"], of["mm"] = (max(gap) for gap in zip(*gaps[name], strict=True))
    return {"contestants": found, "left_out": left_out}


def table(title: str, result: dict, views: list[int]) -> str:
    """Medians, spread, ratios, memory, as Markdown."""
    found = result["contestants"]
    median = {n: {v: statistics.median(of["ms"][v]) for v in views} for n, of in found.items()}
    ours = median.get("mvtop")
    head = [f"{v} views" if v > 1 else "1 view" for v in views]
    lines = [
        f"{title}: median ms (quartiles), x mvtop's",
        "",
        f"| | {' | '.join(head)} | per doubling | peak MB at {views[-1]} | off, degrees, mm |",
        "|---" * (len(views) + 4) + "|",
    ]
    for name, of in found.items():
        cells = []
        for v in views:
            low, _, high = statistics.quantiles(of["ms"][v], n=4)
            ratio = f", x{median[name][v] / ours[v]:.2f}" if ours and name != "mvtop" else ""
            cells.append(f"{median[name][v]:.0f} ({low:.0f} to {high:.0f}){ratio}")
        steps = [v for v in views if 2 * v in views and v <= 2]  # the paper's: 1, 2, 4
        factor = [median[name][2 * v] / median[name][v] for v in steps]
        doubled = f"{statistics.geometric_mean(factor):.2f}" if factor else ""
        off = f"{of['degrees']:.3f}, {of['mm']:.3f}"
        peak = f"{of['peak_mb'][views[-1]]:.0f}"
        lines.append(f"| {name} | {' | '.join(cells)} | {doubled} | {peak} | {off} |")
    lines += ["", *(f"Left out: {name}: {why}" for name, why in result["left_out"].items())]
    return "\n".join(lines)


def disagreements(result: dict) -> list[str]:
    """What is further from the reference than TOLERANCE."""
    wrong = []
    for name, of in result["contestants"].items():
        degrees, mm = TOLERANCE[of["precision"]]
        if of["degrees"] > degrees or of["mm"] > mm:
            wrong.append(
                f"{name}: expected poses within {degrees} degrees and {mm} mm of {REFERENCE}'s, "
                f"got {of['degrees']:.3f} and {of['mm']:.3f}"
            )
    return wrong


def plot(results: dict, views: list[int], path: Path) -> None:
    import matplotlib

    matplotlib.use("svg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, len(results), figsize=(5 * len(results), 4), squeeze=False)
    for axis, (title, result) in zip(axes[0], results.items(), strict=True):
        for name, of in result["contestants"].items():
            low, middle, high = zip(
                *(statistics.quantiles(of["ms"][v], n=4) for v in views), strict=True
            )
            (line,) = axis.plot(views, middle, marker="o", label=name)
            axis.fill_between(views, low, high, alpha=0.15, color=line.get_color())
        axis.set(xscale="log", yscale="log", xticks=views, xticklabels=views, title=title)
        axis.set(xlabel="views", ylabel="ms")
    axes[0][0].legend(fontsize="small")
    figure.tight_layout()
    figure.savefig(path)


def machine() -> dict:
    """What the times are of."""
    info = Path("/proc/cpuinfo")
    models = [line for line in info.read_text().splitlines() if line.startswith("model name")]
    packages = ("mvtop", "onnxruntime", "openvino", "nncf", "torch")
    return {
        "processor": models[0].split(":")[1].strip() if models else platform.processor(),
        "cores": os.cpu_count(),
        "load_at_start": os.getloadavg()[0],
        "system": platform.platform(),
        "python": platform.python_version(),
        "packages": {name: _version(name) for name in packages},
    }


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


@command
def main():
    parser = argument_parser(__doc__)
    default = ["small"]
    parser.add_argument(
        "--network", nargs="+", default=default, metavar="NAME",
        help="weights, or presets (their weights are random)",
    )  # fmt: skip
    parser.add_argument("--views", type=int, nargs="+", default=[1, 2, 4, 8])
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--seconds", type=float, default=300, help="a contestant has to get ready")
    parser.add_argument(
        "--without", nargs="+", default=[], choices=CONTESTANTS, metavar="CONTESTANT"
    )
    parser.add_argument("--out", type=Path, default=ROOT / "out/peers")
    parser.add_argument(
        "--openvino-library", type=Path, metavar="FILE",
        help="libonnxruntime.so of the package onnxruntime-openvino, for mvtop on OpenVINO",
    )  # fmt: skip
    args = parser.parse_args()
    if args.rounds < 2 or min(args.views) < 1:
        raise UserError("--rounds, --views: expected two rounds and one view or more")
    names, missing = [name for name in CONTESTANTS if name not in args.without], {}
    for package, kind in (("openvino", ""), ("nncf", "int8")):
        if importlib.util.find_spec(package) is None:
            fix = f"not installed: .venv/bin/python -m pip install {package}"
            theirs = [name for name in names if name.startswith("OpenVINO") and kind in name]
            missing |= dict.fromkeys(theirs, fix)
    if args.openvino_library:
        os.environ[LIBRARY] = str(args.openvino_library.resolve())
    else:
        missing |= {n: "no --openvino-library" for n in names if n.startswith("mvtop OpenVINO")}
    names = [name for name in names if name not in missing]
    views, about, results = sorted(set(args.views)), machine(), {}
    for name in args.network:
        title = Path(name).name.split(".")[0]
        work = args.out / title
        work.mkdir(parents=True, exist_ok=True)
        prepare(network(name), work, views[-1])
        results[title] = compare(work, names, views, args.rounds, args.seconds)
        results[title]["left_out"] |= missing
        random_weights = name in configs.PRESETS
        results[title]["random_weights"] = random_weights
        print(
            table(title + " (random weights)" * random_weights, results[title], views), flush=True
        )
        said = {"machine": about, "views": views, "rounds": args.rounds, "networks": results}
        (args.out / "peers.json").write_text(json.dumps(said, indent=1) + "\n")
    print(json.dumps(about))
    plot(results, views, args.out / "peers.svg")
    wrong = [f"{title}: {one}" for title, of in results.items() for one in disagreements(of)]
    if wrong:
        raise UserError("; ".join(wrong))


if __name__ == "__main__":
    main()

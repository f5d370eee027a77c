"""What `mvtop-cli rig check` says of wrong rigs by images, and where `rig refine` moves them.

    mvtop-train generate --out data/rig --split test --scenes 24 --rig rig.json --mesh ...
    python -m mvtop_train.study.rigs --data data/rig --rig rig.json --model models/ycbv4 \\
        --sets 6 --out out/rigs.jsonl

Takes scenes that were all rendered through one rig of pinhole cameras, in groups of `--sets`; of
each group the last camera stands wrong in several ways. Prints the table of docs/benchmarks.md,
and writes what it is made of, one line for each group and lie; a run that was stopped goes on
there. Errors are of the last camera against the first.
"""

import json
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from tqdm import tqdm

from ..errors import UserError, argument_parser, asking_mvtop, command
from ..evaluation.shots import Lie, Shot, Shots, moved, of_all, relative, rolled, turned

RIGS: dict[str, Lie] = {
    "true": lambda shots, rng: shots,
    "turned by 1 degree": turned(1),
    "turned by 2 degrees": turned(2),
    "turned by 5 degrees": turned(5),
    "moved by 10 mm": moved(0.01),
    "moved by 20 mm": moved(0.02),
    "moved by 50 mm": moved(0.05),
    "rolled by 10 degrees": rolled(10),
    "direction swapped": relative(np.linalg.inv),
    "OpenGL axes": of_all(
        lambda s: Shot(s.id, s.k, s.world_from_cam @ np.diag([1.0, -1, -1, 1]), s.image)
    ),
}


def groups(data: Path, split: str, sets: int) -> list[list[str]]:
    """Of each group of scenes its images, as `ID=PATH`."""
    scenes = []
    for path in sorted((data / split).glob("[0-9]*/scene_camera.json")):
        images = json.loads(path.read_text())
        if any("camera" not in about for about in images.values()):
            raise UserError(
                f"{path}: expected the name of each image's camera, got none; "
                "fix: scenes of mvtop-train generate --rig FILE"
            )
        shown = path.parent / "rgb"
        named = [f"{a['camera']}={shown / f'{int(n):06d}.jpg'}" for n, a in images.items()]
        if len(named) > 1:
            scenes.append(named)
    starts = range(0, len(scenes) - sets + 1, sets)
    return [[path for scene in scenes[at : at + sets] for path in scene] for at in starts]


def error(rig: Shots, truth: Shots) -> tuple[float, float]:
    """Of the last camera against the first: degrees, mm."""
    of_both = [np.linalg.inv(r[0].world_from_cam) @ r[-1].world_from_cam for r in (rig, truth)]
    off = np.linalg.inv(of_both[0]) @ of_both[1]
    degrees = np.rad2deg(Rotation.from_matrix(off[:3, :3]).magnitude())
    return float(degrees), float(1e3 * np.linalg.norm(off[:3, 3]))


def read(path: Path) -> tuple[Shots, list[tuple[int, int]]]:
    """The cameras of a rig, without images, and the sizes of these."""
    import mvtop  # loads its compiled part

    with asking_mvtop("--rig FILE"):
        cameras = mvtop.Rig.load(path).cameras
    shots = [Shot(c.id, np.array(c.K), np.array(c.world_from_cam), None) for c in cameras]
    return shots, [tuple(c.size) for c in cameras]


def write(path: Path, shots: Shots, sizes: list[tuple[int, int]]):
    import mvtop  # loads its compiled part

    cameras = [
        mvtop.Camera(shot.k, size, world_from_cam=shot.world_from_cam, id=shot.id)
        for shot, size in zip(shots, sizes, strict=True)
    ]
    mvtop.Rig(cameras).save(path)


def outcome(args, shots: Shots, truth: Shots, sizes, images: list[str]) -> dict:
    """What is said of a rig, and how far its last camera is off before and after."""
    with tempfile.TemporaryDirectory() as temporary:
        rig, better = Path(temporary) / "rig.json", Path(temporary) / "better.json"
        write(rig, shots, sizes)

        def run(*command) -> str:
            command = [args.cli, "rig", *map(str, command), "--model", str(args.model)]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            return done.stderr.strip().splitlines()[-1] if done.returncode else ""

        line = {"said": run("check", rig, *images), "before": error(shots, truth)}
        line["refused"] = run("refine", rig, *images, "-o", better)
        if better.exists():
            line["after"] = error(read(better)[0], truth)
    return line


def table(lines: list[dict], last: str) -> str:
    """Markdown: of each lie how often it is noticed, and what the refined rigs are off by."""
    head = ["the last camera", "groups", "check fails", "names it", "refined", "off by"]
    rows = [[*head, "after, median", "worst"]]
    for name in RIGS:
        told = [line for line in lines if line["lie"] == name]
        if not told:
            continue
        # The camera alone, or the reading that all poses need.
        causes = (f"`{last}` does not stand", "read in")
        named = sum(any(cause in line["said"] for cause in causes) for line in told)
        after = np.array([line["after"] for line in told if "after" in line])

        def text(pair) -> str:
            return f"{pair[0]:.1f}°, {pair[1]:.0f} mm"

        before = text(np.median([line["before"] for line in told], axis=0))
        ends = [text(f(after, axis=0)) for f in (np.median, np.max)] if len(after) else ["–"] * 2
        failed = sum(bool(line["said"]) for line in told)
        rows.append([name, len(told), failed, named, len(after), before, *ends])
    rows.insert(1, ["---"] * len(rows[0]))
    return "".join("| " + " | ".join(str(cell) for cell in row) + " |\n" for row in rows)


@command
def main():
    parser = argument_parser(__doc__)
    parser.add_argument("--data", type=Path, required=True, help="scenes in BOP's layout")
    parser.add_argument("--split", default="test")
    parser.add_argument("--rig", type=Path, required=True, help="the rig of all its scenes")
    parser.add_argument("--model", type=Path, required=True, help="bundle with meshes")
    parser.add_argument("--sets", type=int, default=6, help="scenes in a group")
    parser.add_argument("--seed", type=int, default=0, help="of the lies' directions")
    parser.add_argument("--cli", default="target/release/mvtop-cli")
    parser.add_argument("--out", type=Path, required=True, help="file of JSON Lines")
    args = parser.parse_args()
    truth, sizes = read(args.rig)
    all_groups = groups(args.data, args.split, args.sets)
    lines = []
    if args.out.exists():
        lines = [json.loads(line) for line in args.out.read_text().splitlines()]
    known = {(line["group"], line["lie"]) for line in lines}
    args.out.parent.mkdir(parents=True, exist_ok=True)
    with args.out.open("a") as file:
        for number, images in enumerate(tqdm(all_groups, unit="group")):
            for index, (name, lie) in enumerate(RIGS.items()):
                if (number, name) in known:
                    continue
                # Of its own for each, so that what one draws changes no other.
                rng = np.random.default_rng([args.seed, number, index])
                line = {"group": number, "lie": name}
                lines.append(line | outcome(args, lie(truth, rng), truth, sizes, images))
                file.write(json.dumps(lines[-1]) + "\n")
                file.flush()
    print(table(lines, truth[-1].id), end="")


if __name__ == "__main__":
    main()

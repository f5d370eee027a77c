"""How light and framing change poses: the same pairs, disturbed, the calibration still true.

    python -m mvtop_train.study.framing --samples out/eval/hard-seed0-views2-100 \\
        --out out/framing.jsonl

Reads samples as `mvtop-cli eval samples` does, disturbs their images in memory (where the camera is
another one afterwards, its calibration is, too), and predicts with and without refinement, boxes
detected. Prints the table of docs/benchmarks.md, and writes what it is made of, one line for each
sample, disturbance and way, to `--out`; a run that was stopped goes on there. Needs mvtop's wheel
(`make wheel`).
"""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from tqdm import tqdm

from ..errors import UserError, asking_mvtop, command
from ..evaluation.shots import Lie, Shot, Shots, of_all, of_last
from .disturbed import arguments

GREY = 128


def brighter(factor: float) -> Lie:
    """Values times a factor, cut off at white."""
    return of_all(
        lambda s: replace(s, image=np.clip(factor * s.image + 0.5, 0, 255).astype(np.uint8))
    )


def noisy(deviation: float) -> Lie:
    """Normal noise on each value of 255."""

    def change(shots: Shots, rng: np.random.Generator) -> Shots:
        disturbed = []
        for shot in shots:
            values = shot.image + rng.normal(0, deviation, shot.image.shape)
            disturbed.append(replace(shot, image=np.clip(values + 0.5, 0, 255).astype(np.uint8)))
        return disturbed

    return change


def bordered(width: int, height: int) -> Lie:
    """In the middle of a larger grey image: the principal point moves along."""

    def change(shot: Shot) -> Shot:
        rows, columns = shot.image.shape[:2]
        left, top = (width - columns) // 2, (height - rows) // 2
        image = np.full((height, width, 3), GREY, np.uint8)
        image[top : top + rows, left : left + columns] = shot.image
        k = shot.k.copy()
        k[:2, 2] += left, top
        return replace(shot, image=image, k=k)

    return of_all(change)


def upside_down(shot: Shot) -> Shot:
    """As the camera takes it, turned by 180 degrees about its optical axis."""
    height, width = shot.image.shape[:2]
    k = shot.k.copy()
    k[:2, 2] = width - 1 - k[0, 2], height - 1 - k[1, 2]
    pose = shot.world_from_cam @ np.diag([-1.0, -1, 1, 1])
    return replace(
        shot, image=np.ascontiguousarray(shot.image[::-1, ::-1]), k=k, world_from_cam=pose
    )


CASES: dict[str, Lie] = {
    "nothing": lambda shots, rng: shots,
    "half as bright": brighter(0.5),
    "1.5 times as bright": brighter(1.5),
    "noise of 10 of 255": noisy(10),
    "grey border to 1280x720": bordered(1280, 720),
    "one camera upside down": of_last(lambda shot, rng: upside_down(shot)),
    "all cameras upside down": of_all(upside_down),
}
WAYS = {"network": False, "refined": True}


def read(folder: Path) -> Shots:
    """The cameras and images of a sample."""
    import mvtop  # loads its compiled part

    with asking_mvtop("--samples DIR of mvtop-train samples"):
        cameras = mvtop.Rig.load(folder / "rig.json").cameras
    shots = []
    for camera in cameras:
        image = cv2.imread(str(folder / f"{camera.id}.png"))
        if image is None or camera.model != "pinhole" or len(camera.distortion):
            raise UserError(
                f"{folder}/{camera.id}.png: expected an image of a pinhole camera without "
                "distortion, got none; fix: mvtop-train samples"
            )
        pose = np.array(camera.world_from_cam)
        shots.append(Shot(camera.id, np.array(camera.K), pose, image[:, :, ::-1].copy()))
    return shots


def answer(estimator, shots: Shots, world_from_obj: np.ndarray, refine: bool) -> dict:
    """How far the nearest prediction within the object's diameter is off, if there is one."""
    import mvtop  # loads its compiled part

    cameras = [
        mvtop.Camera(s.k, s.image.shape[1::-1], world_from_cam=s.world_from_cam, id=s.id)
        for s in shots
    ]
    prediction = estimator.predict([s.image for s in shots], mvtop.Rig(cameras), refine=refine)

    def away(found) -> float:
        return float(np.linalg.norm(found.world_from_obj[:3, 3] - world_from_obj[:3, 3]))

    nearest = min(prediction.objects, key=away, default=None)
    if nearest is None or away(nearest) > estimator.classes[0].diameter_m:
        return {"found": False}
    turn = nearest.world_from_obj[:3, :3].T @ world_from_obj[:3, :3]
    return {
        "found": True,
        "boxes": len(nearest.boxes),
        "rot_deg": float(np.rad2deg(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))),
        "t_m": away(nearest),
        "sigma_deg": nearest.sigma.rot_deg,
        "sigma_m": nearest.sigma.t_m,
    }


def table(lines: list[dict]) -> str:
    """Markdown: of each way and disturbance means and medians over the found objects."""
    rows = [
        ["way", "disturbed", "found", "boxes", "rotation, mean (median)", "over 30°"]
        + ["translation, mean (median)", "expected rotation", "expected translation"]
    ]
    rows.append(["---"] * len(rows[0]))
    for way in WAYS:
        for case in CASES:
            told = [line for line in lines if (line["way"], line["case"]) == (way, case)]
            found = [line for line in told if line["found"]]
            if not found:
                continue

            def of(key: str, found=found) -> np.ndarray:
                return np.array([line[key] for line in found])

            turn, off = of("rot_deg"), 1e3 * of("t_m")
            rows.append([
                way, case, f"{len(found)}/{len(told)}", of("boxes").sum(),
                f"{turn.mean():.2f}° ({np.median(turn):.2f}°)", f"{100 * np.mean(turn > 30):.0f} %",
                f"{off.mean():.1f} mm ({np.median(off):.1f})", f"{of('sigma_deg').mean():.2f}°",
                f"{1e3 * of('sigma_m').mean():.1f} mm",
            ])  # fmt: skip
    return "".join("| " + " | ".join(str(cell) for cell in row) + " |\n" for row in rows)


def measure(
    folders: list[Path], model: Path, out: Path, seed: int = 0, cases: dict[str, Lie] = CASES
) -> list[dict]:
    """What becomes of every disturbance of every sample; goes on where `out` ends."""
    import mvtop  # loads its compiled part

    with asking_mvtop("--model DIR"):
        estimator = mvtop.Estimator.load(model)
    lines = [json.loads(line) for line in out.read_text().splitlines()] if out.exists() else []
    known = {(line["sample"], line["case"], line["way"]) for line in lines}
    out.parent.mkdir(parents=True, exist_ok=True)
    with out.open("a") as file:
        for number, folder in enumerate(tqdm(folders, unit="sample")):
            shots = read(folder)
            truth = json.loads((folder / "truth.json").read_text())["objects"][0]
            for index, (case, disturb) in enumerate(CASES.items()):
                for way, refine in WAYS.items():
                    if case not in cases or (folder.name, case, way) in known:
                        continue
                    # Of its own for each, so that what one draws changes no other.
                    rng = np.random.default_rng([seed, number, index])
                    line = {"sample": folder.name, "case": case, "way": way}
                    disturbed = disturb(shots, rng)
                    pose = np.array(truth["T_world_obj"])
                    lines.append(line | answer(estimator, disturbed, pose, refine))
                    file.write(json.dumps(lines[-1]) + "\n")
                    file.flush()
    return lines


@command
def main():
    args, folders = arguments(__doc__, "noise")
    print(table(measure(folders, args.model, args.out, args.seed)), end="")


if __name__ == "__main__":
    main()

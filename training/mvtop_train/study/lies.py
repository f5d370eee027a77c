"""How many wrong calibrations are noticed: lies about rigs, and what becomes of each.

    python -m mvtop_train.study.lies --samples out/eval/hard-seed0-views2-100 --out out/lies.jsonl

Reads samples as `mvtop-cli eval samples` does, tells each kind of lie about each, and predicts. A
lie is noticed where the rig is refused or its prediction warned of; with true calibrations that is
a false alarm. Prints the table of docs/warnings.md, and writes what it is made of, one line for
each sample and lie, to `--out`; a run that was stopped goes on there. Needs mvtop's wheel (`make
wheel`).
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation
from tqdm import tqdm

from ..errors import UserError, asking_mvtop, command
from .disturbed import arguments


@dataclass(frozen=True)
class Shot:
    """A camera as its rig file has it, and its image."""

    id: str
    k: np.ndarray  # [3, 3] px
    world_from_cam: np.ndarray  # [4, 4] metres
    image: np.ndarray  # [H, W, 3] RGB
    model: str = "pinhole"
    distortion: tuple = ()


Shots = list[Shot]
Lie = Callable[[Shots, np.random.Generator], Shots]


def _moved(shot: Shot, cam_from_new: np.ndarray) -> Shot:
    return replace(shot, world_from_cam=shot.world_from_cam @ cam_from_new)


def _turn(rotvec) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(np.asarray(rotvec, float)).as_matrix()
    return pose


def _direction(rng: np.random.Generator) -> np.ndarray:
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


def of_last(change: Callable[[Shot, np.random.Generator], Shot]) -> Lie:
    """A lie about the last camera."""
    return lambda shots, rng: [*shots[:-1], change(shots[-1], rng)]


def of_all(change: Callable[[Shot], Shot]) -> Lie:
    """The same lie about every camera."""
    return lambda shots, rng: [change(shot) for shot in shots]


def turned(degrees: float) -> Lie:
    """About a random axis through its center."""
    angle = np.deg2rad(degrees)
    return of_last(lambda shot, rng: _moved(shot, _turn(angle * _direction(rng))))


def rolled(degrees: float) -> Lie:
    """About its optical axis, to a random side."""
    axis = np.array([0, 0, np.deg2rad(degrees)])
    return of_last(lambda shot, rng: _moved(shot, _turn(axis * rng.choice([-1, 1]))))


def moved(metres: float) -> Lie:
    """Its center, in a random direction."""

    def change(shot: Shot, rng: np.random.Generator) -> Shot:
        step = np.eye(4)
        step[:3, 3] = metres * _direction(rng)
        return _moved(shot, step)

    return of_last(change)


def scaled(factor: float) -> Lie:
    """All translations, with the first camera as the world."""

    def lie(shots: Shots, rng) -> Shots:
        world = shots[0].world_from_cam
        told = []
        for shot in shots:
            pose = np.linalg.inv(world) @ shot.world_from_cam
            pose[:3, 3] *= factor
            told.append(replace(shot, world_from_cam=pose))
        return told

    return lie


def relative(change: Callable[[np.ndarray], np.ndarray]) -> Lie:
    """About the poses [4, 4] of the cameras in the first one's frame, as of stereo calibrations."""

    def lie(shots: Shots, rng) -> Shots:
        ref_from_world = np.linalg.inv(shots[0].world_from_cam)
        return [
            replace(shot, world_from_cam=change(ref_from_world @ shot.world_from_cam))
            for shot in shots
        ]

    return lie


def _quaternion_misread(pose: np.ndarray) -> np.ndarray:
    """Of w, x, y, z, read as x, y, z, w."""
    wrong = pose.copy()
    xyzw = Rotation.from_matrix(pose[:3, :3]).as_quat()
    wrong[:3, :3] = Rotation.from_quat(xyzw[[3, 0, 1, 2]]).as_matrix()
    return wrong


def _transposed(pose: np.ndarray) -> np.ndarray:
    """Only the rotation is the other way round."""
    wrong = pose.copy()
    wrong[:3, :3] = pose[:3, :3].T
    return wrong


def _opengl(pose: np.ndarray) -> np.ndarray:
    """y up and z back, in a file that is read as y down and z forward."""
    return pose @ np.diag([1.0, -1, -1, 1])


def focal(factor: float) -> Callable[[Shot], Shot]:
    return lambda shot: replace(
        shot, k=shot.k * np.array([[factor, 1, 1], [1, factor, 1], [1, 1, 1]])
    )


def principal_point(pixels: float) -> Lie:
    """Off in a random direction."""

    def change(shot: Shot, rng: np.random.Generator) -> Shot:
        angle = rng.uniform(0, 2 * np.pi)
        k = shot.k.copy()
        k[:2, 2] += pixels * np.array([np.cos(angle), np.sin(angle)])
        return replace(shot, k=k)

    return of_last(change)


def _through_fisheye(shot: Shot) -> Shot:
    """The image as an equidistant lens of this focal length takes it; black where none is known."""
    height, width = shot.image.shape[:2]
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    x, y = (u - shot.k[0, 2]) / shot.k[0, 0], (v - shot.k[1, 2]) / shot.k[1, 1]
    theta = np.hypot(x, y)
    stretch = np.where(theta > 0, np.tan(theta) / np.maximum(theta, 1e-12), 1)
    source = [shot.k[0, 0] * x * stretch + shot.k[0, 2], shot.k[1, 1] * y * stretch + shot.k[1, 2]]
    image = cv2.remap(shot.image, *(s.astype(np.float32) for s in source), cv2.INTER_LINEAR)
    return replace(shot, image=image, model="fisheye", distortion=(0.0,) * 4)


def fisheye_read_as(model: str, distortion: tuple) -> Lie:
    """Both cameras have equidistant lenses."""
    return of_all(lambda s: replace(_through_fisheye(s), model=model, distortion=distortion))


def _halved(shot: Shot) -> Shot:
    """Images of half the size, of which the intrinsics know nothing."""
    height, width = shot.image.shape[:2]
    return replace(
        shot, image=cv2.resize(shot.image, (width // 2, height // 2), 0, 0, 0, cv2.INTER_AREA)
    )


def _swapped(shots: Shots, rng) -> Shots:
    images = [shot.image for shot in shots]
    return [replace(shot, image=image) for shot, image in zip(shots, reversed(images), strict=True)]


def _upside_down(shot: Shot, rng) -> Shot:
    """The image is turned, the calibration is not."""
    return replace(shot, image=np.ascontiguousarray(shot.image[::-1, ::-1]))


def _mirrored(shot: Shot, rng) -> Shot:
    return replace(shot, image=np.ascontiguousarray(shot.image[:, ::-1]))


TRUE = {
    "none: pinhole": lambda shots, rng: shots,
    "none: equidistant": of_all(_through_fisheye),
}
LIES: dict[str, Lie] = {
    "one camera turned by 2 degrees": turned(2),
    "one camera turned by 5 degrees": turned(5),
    "one camera moved by 20 mm": moved(0.02),
    "one camera moved by 50 mm": moved(0.05),
    "one camera rolled by 10 degrees": rolled(10),
    "one camera rolled by 90 degrees": rolled(90),
    "translations 10 % too long": scaled(1.1),
    "translations 1000 times too long": scaled(1000),
    "translations 1000 times too short": scaled(1e-3),
    "direction of poses swapped": relative(np.linalg.inv),
    "rotations transposed": relative(_transposed),
    "OpenGL axes": of_all(lambda s: replace(s, world_from_cam=_opengl(s.world_from_cam))),
    "order of quaternions": relative(_quaternion_misread),
    "focal lengths 1.1 times too long": of_all(focal(1.1)),
    "focal lengths 1.5 times too long": of_all(focal(1.5)),
    "one focal length 1.1 times too long": of_last(lambda s, rng: focal(1.1)(s)),
    "one principal point off by 30 px": principal_point(30),
    "equidistant read as pinhole": fisheye_read_as("pinhole", ()),
    "equidistant read as radtan": fisheye_read_as("pinhole", (0.05, -0.02, 0.01, -0.005)),
    "images of half the size": of_all(_halved),
    "images swapped": _swapped,
    "one image upside down": of_last(_upside_down),
    "one image mirrored": of_last(_mirrored),
}  # fmt: skip


def read(folder: Path) -> Shots:
    """The cameras and images of a sample."""
    import mvtop  # loads its compiled part

    with asking_mvtop("--samples DIR of python -m mvtop_train.synthesis.samples"):
        cameras = mvtop.Rig.load(folder / "rig.json").cameras
    shots = []
    for camera in cameras:
        image = cv2.imread(str(folder / f"{camera.id}.png"))
        if image is None or camera.model != "pinhole" or len(camera.distortion):
            raise UserError(
                f"{folder}/{camera.id}.png: expected an image of a pinhole camera without "
                "distortion, got none; fix: python -m mvtop_train.synthesis.samples"
            )
        pose = np.array(camera.world_from_cam)
        shots.append(Shot(camera.id, np.array(camera.K), pose, image[:, :, ::-1].copy()))
    return shots


def answer(estimator, shots: Shots) -> dict:
    """What becomes of a calibration: `refused`, or `warnings` (codes), and `found` objects."""
    import mvtop  # loads its compiled part

    try:
        cameras = [
            mvtop.Camera(
                shot.k, shot.image.shape[1::-1], distortion=shot.distortion or None,
                model=shot.model, world_from_cam=shot.world_from_cam, id=shot.id,
            )
            for shot in shots
        ]  # fmt: skip
        prediction = estimator.predict([shot.image for shot in shots], mvtop.Rig(cameras))
    except ValueError as error:
        return {"refused": str(error), "warnings": [], "found": 0}
    fit = prediction.rig_consistency
    return {
        "refused": None,
        "warnings": sorted({warning.code for warning in prediction.warnings}),
        "found": len(prediction.objects),
        "px": None if fit is None else fit.px,
        "deviation": None if fit is None else fit.deviation,
        "sigma_t_m": [found.sigma.t_m for found in prediction.objects],
    }


def table(lines: list[dict]) -> str:
    """Markdown: of each lie how many were refused, warned of by each code, and noticed at all."""
    codes = sorted({code for line in lines for code in line["warnings"]})
    rows = [["", "pairs", "refused", *(f"`{code}`" for code in codes), "noticed"]]
    for name in TRUE | LIES:
        told = [line for line in lines if line["lie"] == name]
        if told:
            noticed = sum(bool(line["refused"] or line["warnings"]) for line in told)
            by_code = [sum(code in line["warnings"] for line in told) for code in codes]
            refused = sum(line["refused"] is not None for line in told)
            share = f"{100 * noticed / len(told):.0f} %"
            rows.append([name, len(told), refused, *by_code, share])
    rows.insert(1, ["---"] * len(rows[0]))
    return "".join("| " + " | ".join(str(cell) for cell in row) + " |\n" for row in rows)


def measure(folders: list[Path], model: Path, out: Path, seed: int = 0) -> list[dict]:
    """What becomes of every lie about every sample; goes on where `out` ends."""
    import mvtop  # loads its compiled part

    with asking_mvtop("--model DIR"):
        estimator = mvtop.Estimator.load(model)
    lines = [json.loads(line) for line in out.read_text().splitlines()] if out.exists() else []
    known = {(line["sample"], line["lie"]) for line in lines}
    out.parent.mkdir(parents=True, exist_ok=True)
    with out.open("a") as file:
        for number, folder in enumerate(tqdm(folders, unit="sample")):
            shots = read(folder)
            for index, (name, lie) in enumerate((TRUE | LIES).items()):
                if (folder.name, name) in known:
                    continue
                # Of its own for each, so that what one draws changes no other.
                rng = np.random.default_rng([seed, number, index])
                line = {"sample": folder.name, "lie": name}
                lines.append(line | answer(estimator, lie(shots, rng)))
                file.write(json.dumps(lines[-1]) + "\n")
                file.flush()
    return lines


@command
def main():
    args, folders = arguments(__doc__, "lies' directions")
    print(table(measure(folders, args.model, args.out, args.seed)), end="")


if __name__ == "__main__":
    main()

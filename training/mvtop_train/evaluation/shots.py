"""Cameras and their images as arrays, and changes that make them wrong."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from .groups import Group


@dataclass(frozen=True)
class Shot:
    """A camera as its rig file has it, and the image that is given for it."""

    id: str
    k: np.ndarray  # [3, 3] px
    world_from_cam: np.ndarray  # [4, 4] metres
    image: np.ndarray  # [H, W, 3] RGB
    model: str = "pinhole"
    distortion: tuple = ()
    max_angle_deg: float | None = None
    size: tuple[int, int] | None = None  # width and height by the rig, px; None: the image's
    taken_by: str | None = None  # id of the camera that did take the image; None: another rig's


Shots = list[Shot]
Lie = Callable[[Shots, np.random.Generator], Shots]


def of_group(group: Group) -> Shots:
    """The true cameras of a group, in the rig's order."""
    return [
        Shot(
            camera.id, np.array(camera.K), np.array(camera.world_from_cam), group.images[camera.id],
            camera.model, tuple(camera.distortion), camera.max_angle_deg, tuple(camera.size),
            camera.id,
        )
        for camera in group.rig.cameras
    ]  # fmt: skip


def rig_of(shots: Shots, trust_unit: bool = False):
    """Their mvtop.Rig, with the first camera as reference; ValueError where it is refused."""
    import mvtop  # loads its compiled part

    cameras = [
        mvtop.Camera(
            shot.k, shot.image.shape[1::-1] if shot.size is None else shot.size,
            distortion=shot.distortion or None, model=shot.model,
            world_from_cam=shot.world_from_cam, id=shot.id, max_angle_deg=shot.max_angle_deg,
        )
        for shot in shots
    ]  # fmt: skip
    return mvtop.Rig(cameras, trust_unit=trust_unit)


def of_last(change: Callable[[Shot, np.random.Generator], Shot]) -> Lie:
    """A lie about the last camera."""
    return lambda shots, rng: [*shots[:-1], change(shots[-1], rng)]


def of_all(change: Callable[[Shot], Shot]) -> Lie:
    """The same lie about every camera."""
    return lambda shots, rng: [change(shot) for shot in shots]


def _moved(shot: Shot, cam_from_new: np.ndarray) -> Shot:
    return replace(shot, world_from_cam=shot.world_from_cam @ cam_from_new)


def _turn(rotvec) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(np.asarray(rotvec, float)).as_matrix()
    return pose


def _direction(rng: np.random.Generator) -> np.ndarray:
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


def turned(degrees: float) -> Lie:
    """The last camera, about a random axis through its center."""
    angle = np.deg2rad(degrees)
    return of_last(lambda shot, rng: _moved(shot, _turn(angle * _direction(rng))))


def rolled(degrees: float) -> Lie:
    """The last camera, about its optical axis, to a random side."""
    axis = np.array([0, 0, np.deg2rad(degrees)])
    return of_last(lambda shot, rng: _moved(shot, _turn(axis * rng.choice([-1, 1]))))


def moved(metres: float) -> Lie:
    """The center of the last camera, in a random direction."""

    def change(shot: Shot, rng: np.random.Generator) -> Shot:
        step = np.eye(4)
        step[:3, 3] = metres * _direction(rng)
        return _moved(shot, step)

    return of_last(change)


def relative(change: Callable[[np.ndarray], np.ndarray]) -> Lie:
    """About the poses [4, 4] of the cameras in the first one's frame, as of stereo calibrations."""

    def lie(shots: Shots, rng) -> Shots:
        ref_from_world = np.linalg.inv(shots[0].world_from_cam)
        return [
            replace(shot, world_from_cam=change(ref_from_world @ shot.world_from_cam))
            for shot in shots
        ]

    return lie


def placed(change: Callable[[np.ndarray], np.ndarray]) -> Lie:
    """About the poses world_from_cam [4, 4] of all cameras."""
    return of_all(lambda shot: replace(shot, world_from_cam=change(shot.world_from_cam)))


def scaled(factor: float) -> Lie:
    """All translations, with the first camera as the world."""

    def longer(pose: np.ndarray) -> np.ndarray:
        wrong = pose.copy()
        wrong[:3, 3] *= factor
        return wrong

    return relative(longer)


def quaternion_misread(pose: np.ndarray) -> np.ndarray:
    """Of w, x, y, z, read as x, y, z, w."""
    wrong = pose.copy()
    xyzw = Rotation.from_matrix(pose[:3, :3]).as_quat()
    wrong[:3, :3] = Rotation.from_quat(xyzw[[3, 0, 1, 2]]).as_matrix()
    return wrong


def transposed(pose: np.ndarray) -> np.ndarray:
    """Only the rotation is the other way round."""
    wrong = pose.copy()
    wrong[:3, :3] = pose[:3, :3].T
    return wrong


def opengl(pose: np.ndarray) -> np.ndarray:
    """y up and z back, in a file that is read as y down and z forward."""
    return pose @ np.diag([1.0, -1, -1, 1])


def focal(factor: float) -> Callable[[Shot], Shot]:
    return lambda shot: replace(
        shot, k=shot.k * np.array([[factor, 1, 1], [1, factor, 1], [1, 1, 1]])
    )


def principal_point(pixels: float) -> Lie:
    """Of the last camera, off in a random direction."""

    def change(shot: Shot, rng: np.random.Generator) -> Shot:
        angle = rng.uniform(0, 2 * np.pi)
        k = shot.k.copy()
        k[:2, 2] += pixels * np.array([np.cos(angle), np.sin(angle)])
        return replace(shot, k=k)

    return of_last(change)


def through_fisheye(shot: Shot) -> Shot:
    """The image of a pinhole camera as an equidistant lens of this focal length takes it; black
    where none is known."""
    height, width = shot.image.shape[:2]
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    x, y = (u - shot.k[0, 2]) / shot.k[0, 0], (v - shot.k[1, 2]) / shot.k[1, 1]
    theta = np.hypot(x, y)
    stretch = np.where(theta > 0, np.tan(theta) / np.maximum(theta, 1e-12), 1)
    source = [shot.k[0, 0] * x * stretch + shot.k[0, 2], shot.k[1, 1] * y * stretch + shot.k[1, 2]]
    image = cv2.remap(shot.image, *(s.astype(np.float32) for s in source), cv2.INTER_LINEAR)
    return replace(shot, image=image, model="fisheye", distortion=(0.0,) * 4)


def fisheye_read_as(model: str, distortion: tuple) -> Lie:
    """All cameras have equidistant lenses."""
    return of_all(lambda s: replace(through_fisheye(s), model=model, distortion=distortion))


def halved(shot: Shot) -> Shot:
    """Images of half the size, of which the intrinsics know nothing."""
    height, width = shot.image.shape[:2]
    image = cv2.resize(shot.image, (width // 2, height // 2), 0, 0, 0, cv2.INTER_AREA)
    return replace(shot, image=image, size=None)


def with_image_of(shot: Shot, other: Shot) -> Shot:
    """The camera of one, the image of another."""
    return replace(shot, image=other.image, taken_by=other.taken_by)


def ordered(order: tuple[int, ...]) -> Lie:
    """Each camera is given the image of the camera with that index."""
    return lambda shots, rng: [
        with_image_of(shot, shots[index]) for shot, index in zip(shots, order, strict=True)
    ]


def upside_down(shot: Shot, rng=None) -> Shot:
    """The image is turned by 180 degrees, the calibration is not."""
    return replace(shot, image=np.ascontiguousarray(shot.image[::-1, ::-1]))


def mirrored(shot: Shot, rng=None) -> Shot:
    return replace(shot, image=np.ascontiguousarray(shot.image[:, ::-1]))


def red_as_blue(shot: Shot) -> Shot:
    return replace(shot, image=np.ascontiguousarray(shot.image[:, :, ::-1]))

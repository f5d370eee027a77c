"""Test sets as groups: the images of one rig, and what stands before it.

Two layouts are read: data sets in BOP's, grouped as `mvtop-cli eval bop` does, and folders of
samples (`rig.json`, `truth.json`, an image per camera), as `mvtop-cli eval samples` reads them.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from .. import description
from ..data import bop
from ..errors import UserError, asking_mvtop
from ..files import read_json
from ..network.config import ObjectClass

SAME_OBJECT = 0.2  # diameters: annotations of two views that are nearer are of one object
ENDINGS = ("png", "jpg", "jpeg", "tif", "tiff", "bmp")  # of a sample's images
FIX = "name another bundle or data set"


@dataclass(frozen=True)
class Truth:
    """An object that stands before a rig."""

    known: ObjectClass
    world_from_obj: np.ndarray  # [4, 4] m
    visibility: dict[str, float | None]  # by camera that shows it: visible share; None: not known
    counts: bool = True  # False: found or not, it is neither right nor wrong


@dataclass(frozen=True)
class Group:
    """Images of one moment, their rig, and the truth."""

    name: str  # of its set's groups alone
    scene: str
    rig: object  # mvtop.Rig
    images: dict[str, np.ndarray]  # by camera, [H, W, 3] uint8 RGB
    truth: tuple[Truth, ...]
    asked: frozenset[str]  # classes; estimates of others are neither right nor wrong


@dataclass(frozen=True)
class Planned:
    """A group whose images are not read yet."""

    name: str
    scene: str
    load: Callable[[], Group]


def classes_of(bundle: Path) -> dict[str, ObjectClass]:
    """The classes that a bundle knows, by name, with their symmetries."""
    found = {}
    for one in description.read(bundle)["classes"]:
        discrete = (np.ravel(turn).tolist() for turn in one.get("symmetries_discrete", ()))
        axes = one.get("symmetries_continuous", ())
        continuous = ((*axis["axis"], *axis["offset"]) for axis in axes)
        found[one["name"]] = ObjectClass(
            one["id"], one["name"], one["diameter_m"],
            tuple(map(tuple, discrete)), tuple(continuous),
        )  # fmt: skip
    return found


def classes_in(root: Path, known: Iterable[ObjectClass]) -> dict[int, ObjectClass]:
    """Of a bundle's classes those that a data set has, by id, as its `models_info.json` has them.

    Of an object that the bundle knows by another name, an error.
    """
    with asking_mvtop(FIX):
        import mvtop  # loads its compiled part

        infos = mvtop.bop.read_models_info(root / "models" / "models_info.json")
    found = {}
    for one in known:
        info = infos.get(one.id)
        if info is None:
            continue
        if info.name not in (None, one.name):
            raise UserError(
                f"{root}: expected object {one.id} to be `{one.name}`, as in the model, got "
                f"`{info.name}`; fix: {FIX}"
            )
        discrete = tuple(tuple(np.ravel(turn).tolist()) for turn in info.symmetries_discrete)
        axes = tuple((*axis.tolist(), *at.tolist()) for axis, at in info.symmetries_continuous)
        found[one.id] = replace(one, diameter_m=info.diameter_m, discrete=discrete, continuous=axes)
    if not found:
        raise UserError(f"{root}: expected objects that the model knows, got none; fix: {FIX}")
    return found


def of_samples(
    folder: Path, known: dict[str, ObjectClass], most: int | None = None, prefix: str = ""
) -> list[Planned]:
    """A group of each sample in a folder, in order, at most so many; or the folder is one itself.

    - known: the model's classes, by name
    - prefix: of names, where groups of several folders come together
    """
    alone = (folder / "rig.json").is_file()
    paths = [folder] if alone else sorted(path.parent for path in folder.glob("*/rig.json"))
    if not paths:
        raise UserError(
            f"{folder}: expected folders with rig.json and images, got none; "
            "fix: mvtop-train samples"
        )
    planned = []
    for path in paths[:most]:
        name = prefix + path.name
        planned.append(Planned(name, name, partial(_sample, path, name, known)))
    return planned


def _sample(folder: Path, name: str, known: dict[str, ObjectClass]) -> Group:
    import mvtop  # loads its compiled part

    with asking_mvtop("the sample's rig.json"):
        rig = mvtop.Rig.load(folder / "rig.json")
    paths = []
    for camera in rig.cameras:
        files = [folder / f"{camera.id}.{ending}" for ending in ENDINGS]
        file = next((file for file in files if file.is_file()), None)
        if file is None:
            raise UserError(f"{files[0]}: expected the camera's image, got none; fix: put it there")
        paths.append(file)
    truth = []
    for one in read_json(folder / "truth.json", "a sample has one")["objects"]:
        if one["class"] not in known:
            raise UserError(
                f"{folder}: expected objects that the model knows, got `{one['class']}`; fix: {FIX}"
            )
        shown = dict.fromkeys(one["boxes"])
        truth.append(Truth(known[one["class"]], np.array(one["T_world_obj"]), shown))
    return Group(name, name, rig, decoded(rig, paths), tuple(truth), frozenset(known))


def decoded(rig, paths: list[Path]) -> dict[str, np.ndarray]:
    """By camera of the rig its image, [H, W, 3] uint8 RGB, as mvtop itself reads files: other
    decoders of JPEG differ by a grey level, and hard poses with it by degrees."""
    from mvtop._mvtop import NativeEstimator

    with asking_mvtop("put an image of the camera there"):
        arrays = NativeEstimator.images(rig, list(enumerate(paths)))
    return {camera.id: array for camera, array in zip(rig.cameras, arrays, strict=True)}


def of_bop(
    root: Path,
    views: int,
    known: dict[int, ObjectClass],
    *,
    split: str = "test",
    disjoint: bool = False,
    scenes: int | None = None,
) -> list[Planned]:
    """The groups of so many views of a split, scene by scene; of fewer images there is none.

    - known: the objects that count, by id
    - disjoint: no two groups have an image in common; else each image is once the reference
    - scenes: the first ones, at most
    """
    folders = bop.whole_scenes(root / split)[:scenes]
    if not folders:
        bop.refuse_empty(root, split)
    planned = []
    for folder in folders:
        images = sorted(bop.read_images(folder), key=lambda image: image.number)
        for chosen in choices(len(images), views, disjoint):
            group = [images[n] for n in chosen]
            if any(one.obj_id in known for one in group[0].instances):
                numbers = "+".join(f"{image.number:06d}" for image in group)
                name = f"{folder.name}/{numbers}"
                planned.append(Planned(name, folder.name, partial(_views, group, name, known)))
    return planned


def choices(count: int, views: int, disjoint: bool) -> list[list[int]]:
    """Which of a scene's images go together: each reference, and others evenly spread over those
    that follow it, from the first again after the last."""
    if count < views:
        return []
    found, used = [], set()
    for reference in range(count):
        others = [*range(reference + 1, count), *range(reference)]
        at = ((k + 1) * count // views - 1 for k in range(views - 1))
        group = [reference, *(others[place] for place in at)]
        if not disjoint or used.isdisjoint(group):
            found.append(group)
            used.update(group)
    return found


def _views(images: list[bop.Image], name: str, known: dict[int, ObjectClass]) -> Group:
    rig, _ = bop.rig_of(images)
    pictures = decoded(rig, [image.path for image in images])
    asked = frozenset(one.name for one in known.values())
    truth = tuple(truth_of(images, known))
    return Group(name, name.split("/")[0], rig, pictures, truth, asked)


def truth_of(images: list[bop.Image], known: dict[int, ObjectClass]) -> list[Truth]:
    """What is annotated in the first image counts; what other images alone show is there too."""
    placed = [
        [
            (one, np.linalg.inv(image.cam_from_world) @ one.cam_from_obj)
            for one in image.instances
            if one.obj_id in known
        ]
        for image in images
    ]

    def apart(pose: np.ndarray, other: np.ndarray, obj: ObjectClass) -> float:
        return np.linalg.norm(pose[:3, 3] - other[:3, 3]) / obj.diameter_m

    def visibility(obj: ObjectClass, pose: np.ndarray) -> dict[str, float | None]:
        shown = {}
        for camera, view in enumerate(placed):
            alike = [(apart(at, pose, obj), one) for one, at in view if one.obj_id == obj.id]
            away, nearest = min(alike, key=lambda pair: pair[0], default=(np.inf, None))
            if away <= SAME_OBJECT:
                shown[str(camera)] = nearest.visible_share
        return shown

    truth: list[Truth] = []
    for number, view in enumerate(placed):
        for one, pose in view:
            obj = known[one.obj_id]
            same = (
                other.known.id == obj.id and apart(other.world_from_obj, pose, obj) <= SAME_OBJECT
                for other in truth
            )
            if number == 0 or not any(same):
                truth.append(Truth(obj, pose, visibility(obj, pose), counts=number == 0))
    return truth

"""What is asked of images: which parts, where, how sure, and in which frame."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

from mvtop._inputs import boxes_by_camera
from mvtop._mvtop import check_request
from mvtop._printable import refused

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from mvtop._inputs import Boxes

# Files have another name for it.
_BASE = ("base_from_world", "T_base_world")


@dataclass(frozen=True)
class Prior:
    """A rough pose of an object.

    Objects of its class are given only within three standard deviations, in distance and in angle,
    of one of the class's priors. They are looked for there even if the detector sees nothing.

    Parameters
    ----------
    class_name
        Class of the object.
    world_from_obj : array, (4, 4)
        Object frame to world frame, metres.
    sigma_m, sigma_deg
        Standard deviations of the position, metres, and of the rotation, degrees; from 60 degrees
        on any rotation will do.
    """

    class_name: str
    world_from_obj: ArrayLike
    sigma_m: float
    sigma_deg: float

    def __post_init__(self) -> None:
        rows = _tuples("world_from_obj", self.world_from_obj, (4, 4))
        object.__setattr__(self, "world_from_obj", rows)

    def _document(self) -> dict[str, Any]:
        return {
            "class": self.class_name,
            "T_world_obj": self.world_from_obj,
            "sigma_m": self.sigma_m,
            "sigma_deg": self.sigma_deg,
        }


@dataclass(frozen=True, kw_only=True)
class Plane:
    """A plane on which objects stand upright; others are not given.

    Parameters
    ----------
    point : array, (3,)
        Of the plane, world frame, metres.
    normal : array, (3,)
        Upwards, world frame, of any length.
    within_m, within_deg
        Greatest distance of an object's lowest surface point from the plane, metres, and greatest
        angle between its axis and the normal, degrees.
    axis : array, (3,)
        That of the object which points up, object frame.
    class_name
        Class that stands on it; None: all do.
    """

    point: ArrayLike
    normal: ArrayLike
    within_m: float
    within_deg: float
    axis: ArrayLike = (0.0, 0.0, 1.0)
    class_name: str | None = None

    def __post_init__(self) -> None:
        for name in ("point", "normal", "axis"):
            (vector,) = _tuples(name, [getattr(self, name)], (1, 3))
            object.__setattr__(self, name, vector)

    def _document(self) -> dict[str, Any]:
        named = {} if self.class_name is None else {"class": self.class_name}
        return named | {
            "point_m": self.point,
            "normal": self.normal,
            "axis": self.axis,
            "within_m": self.within_m,
            "within_deg": self.within_deg,
        }


@dataclass(frozen=True, kw_only=True)
class Request:
    """What is asked of images; asks for everything by default.

    Names are those of `mvtop-cli infer` and of the service (docs/how-to/serve.md). Arrays are kept
    as tuples.

    Parameters
    ----------
    classes
        Only objects of these classes, by name; the others are not looked for, which saves time.
    most
        At most as many objects, the most probable ones.
    region : array, (2, 3)
        Only objects whose middle is in this box: its least and its greatest corner, world frame,
        metres.
    polygons
        Only objects whose middle is in the polygon of each of these cameras: corners (N, 2) by
        camera id, px.
    priors
        Rough poses, near which alone objects of their classes are given.
    planes
        Planes on which objects stand.
    frame
        Frame in which poses are given as well, `ObjectPose.frame_from_obj`: "world", "base" or the
        id of a camera.
    base_from_world : array, (4, 4)
        World frame to the robot's base frame, metres.
    min_confidence
        Least confidence of a pose that is accepted, 0 to 1; each object then has a verdict.
    grasps
        Whether the grasps of the bundle's grasps.json are given with each object.
    why
        Whether `Prediction.why` says of each class without an object what came nearest; of
        `classes` it always does.
    reference, boxes, min_views, refine
        As in `Estimator.predict`, whose own arguments replace them.

    Raises
    ------
    ValueError
        Where a value is none of its kind. What does not fit the rig or the model is refused by
        `predict`.

    Examples
    --------
    >>> request = mvtop.Request(classes=["soup_can"], most=1, frame="world")
    >>> estimator.predict(images, rig, request=request)[0].frame_from_obj
    """

    classes: Sequence[str] | None = None
    most: int | None = None
    region: ArrayLike | None = None
    polygons: Mapping[str, ArrayLike] | None = None
    priors: Sequence[Prior] | None = None
    planes: Sequence[Plane] | None = None
    frame: str | None = None
    base_from_world: ArrayLike | None = None
    min_confidence: float | None = None
    grasps: bool = False
    why: bool = False
    reference: str | None = None
    boxes: Boxes | None = None
    min_views: int | None = None
    refine: bool | None = None

    def __post_init__(self) -> None:
        kept: dict[str, Any] = {}
        if self.classes is not None:
            one = isinstance(self.classes, str)
            kept["classes"] = (self.classes,) if one else tuple(self.classes)
        if self.region is not None:
            kept["region"] = _tuples("region", self.region, (2, 3))
        if self.base_from_world is not None:
            kept["base_from_world"] = _tuples("base_from_world", self.base_from_world, (4, 4))
        if self.polygons is not None:
            kept["polygons"] = {
                str(camera): _tuples(f"polygons, camera `{camera}`", corners, (None, 2))
                for camera, corners in self.polygons.items()
            }
        if self.boxes is not None:
            kept["boxes"] = [
                {"class": name, "boxes": boxes} for name, boxes in boxes_by_camera(self.boxes) or []
            ]
        for name, kind in (("priors", Prior), ("planes", Plane)):
            kept[name] = _all_of(name, kind, getattr(self, name)) or None
        for name, value in kept.items():
            object.__setattr__(self, name, value)
        check_request(self.to_json())

    def to_json(self) -> str:
        """As JSON, as the service and `mvtop-cli infer --request` read it."""
        written = {
            field.name: value
            for field in fields(self)
            if (value := getattr(self, field.name)) is not field.default
        }
        for name in {"priors", "planes"} & written.keys():
            written[name] = [one._document() for one in written[name]]
        if self.region is not None:
            written["region"] = dict(zip(("min_m", "max_m"), written["region"], strict=True))
        ours, theirs = _BASE
        if ours in written:
            written[theirs] = written.pop(ours)
        try:
            return json.dumps(written, ensure_ascii=False, allow_nan=False, default=_plain)
        except (TypeError, ValueError) as cause:
            raise refused(f"request: expected names and finite numbers, got: {cause}") from None

    @classmethod
    def from_json(cls, text: str | bytes) -> Request:
        """Reads what `to_json` or `mvtop-cli serve --record` wrote.

        Raises
        ------
        ValueError
            Where it is no request.
        """
        text = text.decode() if isinstance(text, bytes) else text
        check_request(text)
        values = json.loads(text)
        ours, theirs = _BASE
        if theirs in values:
            values[ours] = values.pop(theirs)
        values["priors"] = [
            Prior(one["class"], one["T_world_obj"], one["sigma_m"], one["sigma_deg"])
            for one in values.get("priors", ())
        ]
        values["planes"] = [
            Plane(point=one.pop("point_m"), class_name=one.pop("class", None), **one)
            for one in values.get("planes", ())
        ]
        if values.get("region") is not None:
            values["region"] = [values["region"][corner] for corner in ("min_m", "max_m")]
        return cls(**values)


def json_of(request: Request | None) -> str | None:
    """What the compiled part takes."""
    if request is not None and not isinstance(request, Request):
        got = type(request).__name__
        raise refused(f"request: expected a mvtop.Request, got {got}")
    return None if request is None else request.to_json()


def _all_of(name: str, kind: type, values: Any) -> tuple[Any, ...]:
    """Values of one class; one value stands for itself."""
    several = (values,) if isinstance(values, kind) else tuple(values or ())
    for one in several:
        if not isinstance(one, kind):
            got = type(one).__name__
            raise refused(f"{name}: expected mvtop.{kind.__name__}, got {got}")
    return several


def _plain(value: Any) -> Any:
    """Python's number of one of NumPy's."""
    if not hasattr(value, "item"):
        raise TypeError(type(value).__name__)
    return value.item()


def _tuples(name: str, array: ArrayLike, shape: tuple[int | None, int]) -> tuple[Any, ...]:
    """The rows of an array of finite numbers."""
    import numpy as np

    expected = f"finite numbers of shape {shape}".replace("None", "N")
    try:
        numbers = np.asarray(array, np.float64)
    except (TypeError, ValueError):
        raise refused(f"{name}: expected {expected}, got {type(array).__name__}") from None
    rows, columns = shape
    fits = numbers.ndim == 2 and rows in (None, len(numbers)) and numbers.shape[1] == columns
    if not fits or not np.isfinite(numbers).all():
        got = "some that are not finite" if fits else f"shape {numbers.shape}"
        raise refused(f"{name}: expected {expected}, got {got}")
    return tuple(tuple(row) for row in numbers.tolist())

"""What a network knows, and what it answers about one object."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from mvtop._mvtop import NativeEstimator


@dataclass(frozen=True, eq=False)
class ObjectClass:
    """One of the objects that a network knows."""

    name: str
    id: int
    diameter_m: float
    """Largest distance between two points of its surface, metres."""
    points: NDArray[np.float64]
    """(P, 3), points on its surface, object frame, metres."""

    def __repr__(self) -> str:
        diameter = f"{1e3 * self.diameter_m:.1f} mm"
        return f"ObjectClass({self.name!r}, id {self.id}, {diameter}, {len(self.points)} points)"


def object_classes(native: NativeEstimator) -> list[ObjectClass]:
    """The objects that a network knows."""
    return [
        ObjectClass(name, number, diameter, native.points(i))
        for i, (name, number, diameter) in enumerate(native.classes())
    ]


@dataclass(frozen=True)
class PredictionWarning:
    """What makes poses doubtful, though it is no error."""

    code: str
    """What it is, for programs: "one_color" for an image that shows nothing (docs/warnings.md)."""
    camera: str | None
    """Id of the camera that it is about; None where it is not one."""
    object: int | None
    """Index of the object that it is about, or that shows it most; None where there is none."""
    message: str
    """One sentence: what was seen, and what to do."""


@dataclass(frozen=True)
class RigConsistency:
    """How well the rig fits what was found."""

    px: float
    """How far projections are beside their boxes where these agree best: root mean square over the
    objects, of the camera where it is greatest, px."""
    deviation: float
    """How far the views are from one pose of an object, in standard deviations of what each tells
    by itself; of several objects, the lower median. Warned of above the bundle's
    `most_deviation`."""
    worst_camera: str | None
    """Id of the camera where `px` is greatest; None where only two show objects, of which none is
    known to be wrong."""


@dataclass(frozen=True)
class Sigma:
    """The error that is expected of a pose, by the network or by the refinement."""

    rot_deg: float
    """Expected angle between the true and the predicted rotation, degrees."""
    t_m: float
    """Standard deviation of the translation, metres."""


@dataclass(frozen=True)
class Refinement:
    """How the refinement of a pose on the images went (docs/refinement.md)."""

    accepted: bool
    """Whether the images fit the refined pose better; otherwise the one before was kept."""
    supported: float
    """Share of the mesh's visible edges that the images show where the pose has them."""
    residual_px: float
    """Mean distance of these edges from where the images show them, px of close-ups."""
    overlap: float
    """How likely a pixel within the silhouette is of the object by its color, less how likely one
    next to it is, mean over views: 1 where colors tell them apart, 0 where they do not."""
    explained: float
    """What knowing the part of the object tells of a pixel's color, bits, mean over views."""
    explained_least: float
    """Likewise, of the view where it is least."""
    sigma_before: Sigma
    """How far the network expected its pose to be off, as it may have been another one."""
    print: float | None = None
    """How far the images look like what is printed on the object, mean over the views that tell:
    correlation of color and brightness, at most 1; None without print."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A pose that an object may have."""

    world_from_obj: NDArray[np.float64]
    """(4, 4), object frame to the rig's world frame, metres."""
    sigma: Sigma
    """How far it is expected to be off if it is the right one."""
    probability: float
    """Of all of the object's, they sum up to 1."""


@dataclass(frozen=True, eq=False)
class Undetermined:
    """What no view tells: poses that look like the one that is given."""

    poses: int
    """How many look alike, the one that is given among them, but for turns about the axis."""
    axis: NDArray[np.float64] | None
    """(2, 3), object frame: the direction of an axis about which any turn looks the same, of length
    1, and a point on it, metres."""


@dataclass(frozen=True, eq=False)
class CameraPose:
    """One object as one camera sees it."""

    id: str
    cam_from_obj: NDArray[np.float64]
    """(4, 4), object frame to this camera's frame, metres."""
    box: NDArray[np.float64] | None
    """x0, y0, x1, y1, px; None where the object was not detected."""


@dataclass(frozen=True, eq=False)
class ObjectPose:
    """One object."""

    class_name: str
    class_id: int
    score: float
    """0 to 1; 1 for given boxes."""
    ref_from_obj: NDArray[np.float64]
    """(4, 4), object frame to the reference camera's frame, metres."""
    world_from_obj: NDArray[np.float64]
    """(4, 4), object frame to the rig's world frame, metres."""
    quat_wxyz: NDArray[np.float64]
    """Rotation of `ref_from_obj` as a unit quaternion, w >= 0."""
    sigma: Sigma
    support: float | None
    """Of what the object would cover in the images at this pose, the share that shows it so, 0 to
    1: less where it is hidden or only one of the views has a box of it, least where it is something
    else. None where the model gives no object coordinates."""
    refinement: Refinement | None
    """None where there was none."""
    confidence: float | None
    """Probability that the pose is within the bounds that the model states, 5 degrees and 5 mm if
    it was made as the shipped ones; None where it states none, or the pose was not refined."""
    evidence: dict[str, float] | None
    """What that is computed from, by name (docs/confidence.md); None where the pose was not
    refined."""
    hypotheses: list[Hypothesis]
    """The poses that it may have, far from each other: this one first, then by probability."""
    next_view: str | None
    """Id of the camera, of those that gave no image, in which the hypotheses differ most; None
    where there is one hypothesis or no such camera sees the object."""
    symmetry: Undetermined | None
    """None where the pose is the only one that looks like this."""
    cameras: dict[str, CameraPose]
    """Every camera that gave an image, in the rig's order, by id."""

    @property
    def quat_xyzw(self) -> NDArray[np.float64]:
        """The same quaternion in the order of SciPy and ROS."""
        return self.quat_wxyz[[1, 2, 3, 0]]

    @property
    def cam_from_obj(self) -> dict[str, NDArray[np.float64]]:
        """By camera id: (4, 4), object frame to the camera's frame, metres."""
        return {camera: seen.cam_from_obj for camera, seen in self.cameras.items()}

    @property
    def boxes(self) -> dict[str, NDArray[np.float64]]:
        """By camera id: x0, y0, x1, y1, px, in the cameras that detected the object."""
        return {camera: seen.box for camera, seen in self.cameras.items() if seen.box is not None}

    def __repr__(self) -> str:
        off = f"{self.sigma.rot_deg:.1f} deg and {1e3 * self.sigma.t_m:.1f} mm"
        sure = "" if self.confidence is None else f", right with {100 * self.confidence:.0f} %"
        return (
            f"ObjectPose({self.class_name!r}, score {self.score:.2f}, expected off by {off}{sure})"
        )

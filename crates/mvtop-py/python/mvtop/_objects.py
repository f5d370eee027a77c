"""What a network knows, and what it answers about one object."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

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
    """Its code, for programs, as "one_color"; docs/reference/warnings.md lists them."""
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
    """The greatest of the following over its limit for a true rig; above 1 it is warned of."""
    camera_deviation: float
    """What corrections of all cameras gain, about standard deviations."""
    scale_deviation: float
    """What one scale of the rig, or of its focal lengths, gains, about standard deviations."""
    box_deviation: float
    """How far boxes of an object are off each other, standard deviations, lower median."""
    contradiction: float
    """Log-likelihood ratio by which two cameras do not show the same objects."""
    confirmed: int
    """Objects that both of these cameras show at one pose."""
    unconfirmed: int
    """Objects that one of them shows, and the other should show but does not."""
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
    """How the refinement of a pose on the images went (docs/explanation/refinement.md)."""

    accepted: bool
    """Whether the images fit the refined pose better; otherwise the one before was kept."""
    contour_inliers: float
    """Share of the mesh's visible contour points with an image edge there, mean over views."""
    contour_residual_px: float
    """Mean distance of the visible edges from their projections, px of the crops."""
    color_separation: float
    """Mean probability of belonging to the object, by color, of the silhouette's pixels less that
    of the background's, mean over views: 1 if colors separate them everywhere, 0 if they do not."""
    mutual_information: float
    """Mutual information of segment and color, bits per pixel, mean over views."""
    mutual_information_min: float
    """Mutual information in the view with the least one."""
    initial_sigma: Sigma
    """Expected error of the network's pose."""
    texture_correlation: float | None = None
    """Normalised cross-correlation of the surface's colors with the images, at most 1, mean over
    views; None without texture."""


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
class Grasp:
    """One way to grasp an object."""

    name: str
    """As in the bundle's grasps.json."""
    frame_from_tool: NDArray[np.float64]
    """(4, 4), tool frame to the frame that was asked for, metres; the world's by default."""
    opening_m: float
    """Opening of the gripper, metres."""
    collides: bool | None
    """Whether the gripper would touch another object that was found, given or left out; None where
    its shape is not known."""
    collides_with: list[int] | None
    """Indices of those that are given; None likewise."""


@dataclass(frozen=True, eq=False)
class NearMiss:
    """What came nearest to an object of a class of which none is given."""

    class_name: str
    reason: str
    """What it failed at, for programs: docs/reference/json.md lists the reasons."""
    camera: str | None
    """Id of the camera that shows it best; None where no detection belongs to it."""
    box: NDArray[np.float64] | None
    """(4,), x0 y0 x1 y1 in this camera's image, px."""
    world_from_obj: NDArray[np.float64] | None
    """(4, 4), object frame to world frame, metres; None before it has a pose."""
    value: float | None
    """What was measured, in the unit of the reason."""
    threshold: float | None
    """What it should have reached, or not exceeded."""
    message: str
    """One sentence."""


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
    coordinate_inliers: float | None
    """Share of the object's projection whose object coordinates agree with the pose, 0 to 1, mean
    over the views that should show it. None where the model gives no object coordinates."""
    refinement: Refinement | None
    """None where there was none."""
    confidence: float | None
    """Probability that the pose is within the bounds that the model states, 5 degrees and 5 mm if
    it was made as the shipped ones; None of a model that was not calibrated."""
    evidence: dict[str, Any] | None
    """What the confidence is made of: `log_odds`, `pose` and `views`, terms by name
    (docs/explanation/confidence.md)."""
    hypotheses: list[Hypothesis]
    """The poses that it may have, far from each other: this one first, then by probability."""
    next_view: str | None
    """Id of the camera, of those that gave no image, in which the hypotheses differ most; None
    where there is one hypothesis or no such camera sees the object."""
    symmetry: Undetermined | None
    """None where the pose is the only one that looks like this."""
    cameras: dict[str, CameraPose]
    """Every camera that gave an image, in the rig's order, by id."""
    verdict: str | None = None
    """With `Request.min_confidence`: "accept", "reject" or "need_another_view"."""
    frame_from_obj: NDArray[np.float64] | None = None
    """(4, 4), object frame to the frame of `Request.frame`, metres; None where none was asked."""
    grasps: list[Grasp] | None = None
    """How to grasp it; None where that was not asked."""
    track_id: int | None = None
    """Number by which a `Tracker` or `Tracks` knows the object over time; else None."""

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

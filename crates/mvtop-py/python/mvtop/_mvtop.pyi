from _typeshed import Incomplete, SupportsGetItem, SupportsLenAndGetItem
from numpy import float32, float64, uint8
from numpy.typing import ArrayLike, NDArray
from os import PathLike
from pathlib import Path
from typing import Any, Final, SupportsFloat, SupportsIndex, final

__all__ = ["BOP_RESULTS_HEADER", "PIPELINE_VERSION", "REPORT_SCHEMA_VERSION", "__version__", "Camera", "Image", "Instance", "Mesh", "ModelInfo", "NativeEstimator", "NativePrediction", "NativeTracker", "RefinedRig", "Rig", "RigCheck", "RigCorrection", "Surface", "Symmetries", "Tracks", "auc_exact", "auc_poet", "auc_posecnn", "auroc", "average_recall", "bop_results_line", "box_rays", "calibration", "camera_rays", "check_request", "correlation", "default_inference", "deformable_sampling", "deformable_sampling_backward", "deformable_sampling_forward", "encode_rays", "read_models_info", "read_scene", "recall", "roc_curve", "rotation_error_deg", "rotation_from_6d", "run_cli", "score_results", "set_num_threads", "translation_error", "vsd"]

BOP_RESULTS_HEADER: Final[str]
PIPELINE_VERSION: Final[int]
REPORT_SCHEMA_VERSION: Final[int]
__version__: Final[str]

@final
class Camera:
    """
    A calibrated camera: its lens, and its place in the world.

    Camera frame: x right, y down, z forward. Pixels: integer coordinates are pixel centers, the
    top-left one at (0, 0). Distortion is OpenCV's, in OpenCV's order.
    """
    @property
    def K(self, /) -> NDArray[float64]:
        """
        (3, 3), intrinsics, px.
        """
    def __eq__(self, value: object, /) -> bool: ...
    def __ne__(self, value: object, /) -> bool: ...
    def __new__(cls, /, K: ArrayLike, size: ArrayLike, *, distortion: ArrayLike | None = None, model: str = "pinhole", world_from_cam: ArrayLike | None = None, id: str = "cam0", max_angle_deg: SupportsFloat | SupportsIndex | None = None) -> Camera:
        """
        A camera from arrays.

        Parameters
        ----------
        K : array, (3, 3)
            Intrinsics in px: [[fx, skew, cx], [0, fy, cy], [0, 0, 1]].
        size
            Width and height of its images, px.
        distortion
            Of "pinhole" 0, 4, 5, 8, 12 or 14 of k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4 tx ty, of
            "fisheye" k1 k2 k3 k4; also as rows or columns, as OpenCV returns them.
        model
            "pinhole" (Brown-Conrady) or "fisheye" (Kannala-Brandt).
        world_from_cam : array, (4, 4)
            Camera frame to world frame, metres; the identity by default.
        max_angle_deg
            Greatest angle from the optical axis at which the lens images anything.

        Raises
        ------
        ValueError
            For anything that hints at a mistake, as a rig file does.
        """
    def __reduce__(self, /) -> tuple[Any, tuple[NDArray[float64], tuple[int, int], list[float], str, list[float], list[float], str, float | None]]:
        """
        For pickle. Its rotation goes as a quaternion: what a matrix is made of by rounding is not
        read back equal.
        """
    def __repr__(self, /) -> str: ...
    @staticmethod
    def _restore(K: ArrayLike, size: tuple[SupportsIndex, SupportsIndex], distortion: SupportsGetItem[int, SupportsFloat | SupportsIndex], model: str, q_wxyz: SupportsLenAndGetItem[SupportsFloat | SupportsIndex], t: SupportsLenAndGetItem[SupportsFloat | SupportsIndex], id: str, max_angle_deg: SupportsFloat | SupportsIndex | None) -> Camera:
        """
        A camera that was pickled.
        """
    @property
    def distortion(self, /) -> NDArray[float64]:
        """
        Coefficients in OpenCV's order; none for an ideal pinhole.
        """
    @property
    def id(self, /) -> str: ...
    @property
    def max_angle_deg(self, /) -> float | None:
        """
        Greatest angle from the optical axis at which the lens images anything; None where it is the
        projection alone that ends.
        """
    @property
    def model(self, /) -> str:
        """
        "pinhole" or "fisheye".
        """
    def project(self, /, points: ArrayLike) -> NDArray[float64]:
        """
        Pixels at which the lens images points of the camera frame.

        Parameters
        ----------
        points : array, (..., 3)
            Any unit.

        Returns
        -------
        array, (..., 2)
            Px, also outside the image; NaN for what the lens cannot image: behind the camera, or
            past the angle at which the distortion would fold the image back.
        """
    @property
    def size(self, /) -> tuple[int, int]:
        """
        Width and height of its images, px.
        """
    def unproject(self, /, pixels: ArrayLike) -> NDArray[float64]:
        """
        Directions of the rays that the lens images at pixels: the exact inverse of `project`.

        Parameters
        ----------
        pixels : array, (..., 2)
            Px.

        Returns
        -------
        array, (..., 3)
            Camera frame, of length 1; NaN where no ray meets the pixel.
        """
    @property
    def world_from_cam(self, /) -> NDArray[float64]:
        """
        (4, 4), camera frame to world frame, metres.
        """

@final
class Image:
    """
    An image of a scene: its camera, and what is annotated in it.
    """
    @property
    def K(self, /) -> NDArray[float64]:
        """
        (3, 3), intrinsics, px.
        """
    def __repr__(self, /) -> str: ...
    @property
    def cam_from_world(self, /) -> NDArray[float64] | None:
        """
        (4, 4), world frame to camera frame, metres; None where the data set does not say where its
        cameras stood.
        """
    @property
    def distortion(self, /) -> NDArray[float64]:
        """
        Coefficients in OpenCV's order; none for an ideal pinhole.
        """
    @property
    def instances(self, /) -> list[Instance]:
        """
        In the order of scene_gt.json; none where the annotations are kept back.
        """
    @property
    def more(self, /) -> dict[str, Any]:
        """
        What else scene_camera.json says of it.
        """
    @property
    def number(self, /) -> int:
        """
        Its number in the scene.
        """
    @property
    def path(self, /) -> Path:
        """
        File of the color or grey image.
        """
    @property
    def sensor(self, /) -> str:
        """
        What the files of its camera end in, "cam1" of scene_camera_cam1.json; "" of
        scene_camera.json.
        """

@final
class Instance:
    """
    An annotated object of an image.
    """
    def __repr__(self, /) -> str: ...
    @property
    def box(self, /) -> NDArray[float64] | None:
        """
        (4,), x0, y0, x1, y1, px, of the whole object also where it is hidden (BOP's bbox_obj); None
        where it is not known.
        """
    @property
    def cam_from_obj(self, /) -> NDArray[float64]:
        """
        (4, 4), object frame to camera frame, metres.
        """
    @property
    def more(self, /) -> dict[str, Any]:
        """
        What else scene_gt_info.json says of it.
        """
    @property
    def obj_id(self, /) -> int:
        """
        Number of the object.
        """
    @property
    def visible_box(self, /) -> NDArray[float64] | None:
        """
        (4,), the same of what is visible of it (bbox_visib).
        """
    @property
    def visible_share(self, /) -> float | None:
        """
        Visible share of the object's pixels, 0 to 1 (visib_fract); None where it is not known.
        """

@final
class Mesh:
    """
    A triangle mesh in the object's frame, for depth images.
    """
    def __new__(cls, /, vertices: ArrayLike, triangles: SupportsGetItem[int, SupportsLenAndGetItem[SupportsIndex]]) -> Mesh:
        """

        Parameters
        ----------
        vertices : array, (P, 3)
        triangles
            Three vertices' numbers each; both sides are seen.
        """
    def __repr__(self, /) -> str: ...
    def depth(self, /, cam_from_obj: ArrayLike, camera: Camera, *, half_pixel: bool = False) -> NDArray[float32]:
        """
        Depth image, in the unit of the vertices and the pose.

        Parameters
        ----------
        half_pixel
            Pixels are centered at (0.5, 0.5), as in bop_toolkit's renderers.

        Returns
        -------
        array, (H, W), float32
            Of the camera's size; 0 where there is nothing.

        Raises
        ------
        ValueError
            For a lens with distortion.
        """

@final
class ModelInfo:
    """
    What models_info.json says of an object.
    """
    def __repr__(self, /) -> str: ...
    @property
    def bounds(self, /) -> NDArray[float64] | None:
        """
        (2, 3), least and greatest coordinates, metres; None where the file lacks one.
        """
    @property
    def diameter_m(self, /) -> float:
        """
        Largest distance between two points of the surface, metres.
        """
    @property
    def name(self, /) -> str | None:
        """
        mvtop's own data sets have names, BOP's do not.
        """
    @property
    def symmetries_continuous(self, /) -> list[tuple[NDArray[float64], NDArray[float64]]]:
        """
        Axis and a point on it, (3,) each, metres, about which no turn changes how it looks: as
        `mvtop.metrics.Symmetries` takes them.
        """
    @property
    def symmetries_discrete(self, /) -> NDArray[float64]:
        """
        (S, 4, 4), motions that do not change how the object looks, metres; without the identity.
        """

@final
class NativeEstimator:
    """
    A network that is loaded in this process.
    """
    def __new__(cls, /, bundle: str | PathLike[str], ort_lib: str | PathLike[str] | None, provider: str, threads: SupportsIndex, inference: dict[str, str]) -> NativeEstimator: ...
    def __repr__(self, /) -> str: ...
    def check_rig(self, /, rig: Rig, sets: SupportsGetItem[int, SupportsGetItem[int, tuple[SupportsIndex, Any]]], turn_sd_deg: SupportsFloat | SupportsIndex, shift_sd_m: SupportsFloat | SupportsIndex) -> RigCheck:
        """
        Sets of images, each given by the index of its camera, against the rig that they are of.
        """
    def classes(self, /) -> list[tuple[str, int, float]]:
        """
        Name and number of each class, with its diameter in metres.
        """
    def draw(self, /, prediction: NativePrediction, images: SupportsGetItem[int, tuple[SupportsIndex, Any]], edges: bool) -> list[NDArray[uint8]]:
        """
        Copies of the images with the predicted objects drawn onto them, or their edges alone.
        """
    @staticmethod
    def images(rig: Rig, images: SupportsGetItem[int, tuple[SupportsIndex, Any]]) -> list[NDArray[uint8]]:
        """
        The images as arrays.
        """
    def is_of_this_process(self, /) -> bool:
        """
        Whether it was loaded in the process that asks, and not in one that this was forked from.
        """
    def points(self, /, class_index: SupportsIndex) -> NDArray[float64]:
        """
        (P, 3), points on the surface of a class, metres.
        """
    def predict(self, /, rig: Rig, images: SupportsGetItem[int, tuple[SupportsIndex, Any]], request: str | None, reference: str | None, boxes: SupportsGetItem[int, tuple[str, dict[str, SupportsLenAndGetItem[SupportsFloat | SupportsIndex]]]] | None, min_views: SupportsIndex | None, refine: bool | None, tracks: Tracks | None) -> NativePrediction:
        """
        Images are given by the index of their camera, the request as JSON; what is given beside it
        replaces what it says. `tracks` numbers the objects.
        """

@final
class NativePrediction:
    """
    What the core's estimator answered.
    """
    def __repr__(self, /) -> str: ...
    def only(self, /, objects: SupportsGetItem[int, SupportsIndex]) -> NativePrediction:
        """
        The same of some of its objects alone, by their indices.
        """
    def values(self, /) -> Incomplete:
        """
        What `mvtop.Prediction` is made of.
        """

@final
class NativeTracker:
    """
    Predictions of one rig, again and again, by a network that is loaded in this process.
    """
    def __new__(cls, /, estimator: NativeEstimator, rig: Rig, max_motion_m: SupportsFloat | SupportsIndex | None, patience: SupportsIndex) -> NativeTracker: ...
    def __repr__(self, /) -> str: ...
    def predict(self, /, request: str | None, reference: str | None, boxes: SupportsGetItem[int, tuple[str, dict[str, SupportsLenAndGetItem[SupportsFloat | SupportsIndex]]]] | None, min_views: SupportsIndex | None, refine: bool | None) -> NativePrediction:
        """
        Of the latest images.
        """
    def remove(self, /, camera: SupportsIndex) -> None:
        """
        Forgets the image of a camera, by its index.
        """
    def update(self, /, images: SupportsGetItem[int, tuple[SupportsIndex, Any]]) -> None:
        """
        New images are given by the index of their camera.
        """

@final
class RefinedRig:
    """
    A rig some of whose cameras were moved to where images show them.
    """
    def __repr__(self, /) -> str: ...
    @property
    def held_out_px(self, /) -> tuple[float, float] | None:
        """
        How far edges are off in sets that were held out one by one, by the rig as given and by what the
        other sets show: means, px of close-ups; None of one set.
        """
    @property
    def moved(self, /) -> list[RigCorrection]:
        """
        How cameras were moved.
        """
    @property
    def pairs(self, /) -> dict[tuple[str, str], float]:
        """
        By ids of two cameras, as `RigCheck.pairs`, of the new rig.
        """
    @property
    def rig(self, /) -> Rig:
        """
        The rig; cameras that are not in `moved` stand where they stood.
        """

@final
class Rig:
    """
    The cameras that look at a scene together.
    """
    def __eq__(self, value: object, /) -> bool: ...
    def __len__(self, /) -> int: ...
    def __ne__(self, value: object, /) -> bool: ...
    def __new__(cls, /, cameras: SupportsGetItem[int, Camera], reference: str | None = None, *, trust_unit: bool = False) -> Rig:
        """
        A rig of these cameras.

        Parameters
        ----------
        cameras
            In order.
        reference
            Id of the one in whose frame poses are given, the first by default.
        trust_unit
            Whether the cameras do stand within 2 mm of each other, or up to more than 100 m apart,
            which hints at another unit than metres and is refused else.

        Raises
        ------
        ValueError
            For anything that hints at a mistake, as a rig file does.
        """
    def __reduce__(self, /) -> tuple[Any, tuple[str]]:
        """
        For pickle.
        """
    def __repr__(self, /) -> str: ...
    @classmethod
    def calibrate(cls, /, images: Any, board: Any, **options: "Any") -> Any:
        """
        A rig from images of a board, with a verdict on it: a `mvtop.Calibration`, whose `rig` it is.

        Needs `pip install 'mvtop[calibrate]'`. The same as `mvtop.calibrate`, which says what may be
        given.

        - images: a folder or several, or images by camera and exposure
        - board: a board file, or a `mvtop.calibration.Board`
        - options: lens, intrinsics, cameras, reference, world, layout, measured, ...

        Raises OSError where a file cannot be read, ValueError for what is refused.
        """
    @property
    def cameras(self, /) -> list[Camera]: ...
    @classmethod
    def from_arrays(cls, /, K: ArrayLike, world_from_cam: ArrayLike, sizes: ArrayLike, *, distortion: ArrayLike | None = None, model: str = "pinhole", ids: SupportsGetItem[int, str] | None = None, reference: str | None = None, trust_unit: bool = False) -> Rig:
        """
        A rig of V cameras of one lens model.

        Parameters
        ----------
        K : array, (V, 3, 3), or (3, 3) for all
            Intrinsics, px.
        world_from_cam : array, (V, 4, 4)
            Camera frame to world frame, metres.
        sizes : array, (V, 2), or (2,) for all
            Widths and heights of the images, px.
        distortion : array, (V, n), or (n,) for all
            See Camera.
        ids
            Names of the cameras, "cam0", "cam1", ... by default.
        reference, trust_unit
            As of Rig.
        """
    @classmethod
    def from_json(cls, /, text: str) -> Rig:
        """
        Reads the text of a rig file.
        """
    @classmethod
    def import_file(cls, /, paths: str | PathLike[str] | SupportsGetItem[int, str | PathLike[str]], *, format: str | None = None, scale: SupportsFloat | SupportsIndex | None = None, unit: str | None = None, image_size: tuple[SupportsIndex, SupportsIndex] | None = None, image_sizes: dict[str, tuple[SupportsIndex, SupportsIndex]] | None = None, direction: str | None = None, model: str | None = None, max_angle: SupportsFloat | SupportsIndex | None = None, image: SupportsIndex | None = None, rectified: bool = False, trust_unit: bool = False, ignore: SupportsGetItem[int, str] = ...) -> tuple[Rig, list[str]]:
        """
        Makes a rig of the calibration files of another program.

        docs/how-to/import-a-calibration.md says what to type.

        What the files cannot say is asked for by these names:

        Parameters
        ----------
        paths
            A file, or the files of one rig; of COLMAP, its folder will do.
        format
            "opencv", "ros", "kalibr", "colmap", "bop", "nerf", "callab", "halcon", "euroc",
            "anipose", "easymocap", "camodocal", "openmvg", "alicevision", "open3d", "metashape",
            "multical", "mccalib", "matlab", "zed" or "depthai"; recognised by default.
        scale
            Metres per unit of the files.
        unit
            The same by name, "m", "cm" or "mm".
        image_size
            Width and height of all images, px.
        image_sizes
            Of single cameras, by id.
        direction
            What poses map to what, "world_from_cam" or "cam_from_world".
        model
            "pinhole" or "fisheye".
        max_angle
            Greatest angle from the axis at which a lens images anything or is to be used, degrees.
        image
            Of BOP, the image whose cameras make the rig.
        rectified
            Of ROS, whether images are rectified rather than raw.
        trust_unit
            As of Rig.
        ignore
            Keys that state neither a lens nor a place nor a size; unknown keys are refused otherwise.

        Returns
        -------
        The rig, and a list of sentences: what was taken for what, and errors of fitted lenses in px.

        Raises
        ------
        OSError
            Where a file cannot be read.
        ValueError
            Where it is refused.
        """
    @classmethod
    def load(cls, /, path: str | PathLike[str]) -> Rig:
        """
        Reads a rig file (docs/reference/rig-file.md).

        Warns of a lens that folds inside its image (`MvtopWarning`).

        Raises
        ------
        OSError
            Where it cannot be read.
        ValueError
            Where it is refused.
        """
    @property
    def reference(self, /) -> str:
        """
        Id of the camera in whose frame poses are given.
        """
    def save(self, /, path: str | PathLike[str], *, overwrite: bool = False) -> None:
        """
        Writes a rig file, in metres; what is read back is equal.

        Parameters
        ----------
        overwrite
            Whether a file may be replaced.

        Raises
        ------
        FileExistsError
            Where there is one.
        OSError
            Where it cannot be written.
        """
    def to_json(self, /) -> str:
        """
        The text of a rig file, in metres.
        """
    def to_rerun(self, /, recording: Any | None = None, *, path: str = "mvtop") -> None:
        """
        Logs where cameras stand and look, and the distances between them, to Rerun, below the entity
        `path`.

        Needs `pip install mvtop[viz]`. Start a recording first, for example with `rerun.init`.

        Parameters
        ----------
        recording
            Where to; the active one by default.
        """

@final
class RigCheck:
    """
    What sets of images say of a rig, from `Estimator.check_rig`.
    """
    def __repr__(self, /) -> str: ...
    @property
    def agreeing(self, /) -> int:
        """
        How many of these two cameras or more agree on.
        """
    def corrections(self, /, base: str | None = None) -> list[RigCorrection]:
        """
        How each other camera would be moved, if one stands where the rig says.

        Parameters
        ----------
        base
            Id of that one; the reference by default.

        Raises
        ------
        ValueError
            Where the rig has no such camera.
        """
    @property
    def is_told(self, /) -> bool:
        """
        Whether no other cameras explain the images as well as `off`: of two cameras, either may be the
        wrong one.
        """
    @property
    def noise_px(self, /) -> float:
        """
        What edges of one object in one view are found to err by together, px of close-ups.
        """
    @property
    def objects(self, /) -> int:
        """
        How many objects two cameras or more show, over all sets.
        """
    @property
    def off(self, /) -> list[RigCorrection]:
        """
        The fewest cameras whose being off explains the images; empty where these do not contradict the
        rig.
        """
    @property
    def pairs(self, /) -> dict[tuple[str, str], float]:
        """
        By ids of two cameras, how far the edges of the objects that both show are off at the poses on
        which both agree best: mean, px of close-ups.
        """
    @property
    def problem(self, /) -> str | None:
        """
        What is wrong with the rig, in one sentence; None where the images do not contradict it. That
        is not to say that it is right: `corrections` tells how far off it may be.
        """
    def refined(self, /) -> RefinedRig:
        """
        The rig with the cameras of `off` where the images show them.

        Raises
        ------
        ValueError
            Where there are none, where the images tell too little of where one stands, and where
            sets that were held out fit no better.
        """

@final
class RigCorrection:
    """
    How a camera is to be moved to where images show it.
    """
    def __repr__(self, /) -> str: ...
    @property
    def cam_from_shown(self, /) -> NDArray[float64]:
        """
        From where it stands to where the images show it, in its own axes, metres; (4, 4).
        """
    @property
    def camera(self, /) -> str:
        """
        Id of the camera.
        """
    @property
    def deviation(self, /) -> float:
        """
        How many standard deviations it is, turn and move together.
        """
    @property
    def is_off(self, /) -> bool:
        """
        Whether the camera does not stand where the rig says: one object alone does not tell.
        """
    @property
    def is_told(self, /) -> bool:
        """
        Whether the images tell where it stands.
        """
    @property
    def objects(self, /) -> int:
        """
        On how many objects the camera agrees with others once it is moved.
        """
    @property
    def shift_sd_m(self, /) -> float:
        """
        Standard deviation of the move, along the axis that is known least, metres.
        """
    @property
    def turn_sd_deg(self, /) -> float:
        """
        Standard deviation of the turn, about the axis that is known least, degrees.
        """

@final
class Surface:
    """
    Points on an object's surface, made ready for measuring many poses.

    Poses are (..., 4, 4), object frame to any one frame, in the unit of the points; one of truth
    and estimate may be a single one. Errors are (...), in the unit of the points.
    """
    def __new__(cls, /, points: ArrayLike) -> Surface:
        """

        Parameters
        ----------
        points : array, (P, 3)
            Object frame.
        """
    def __repr__(self, /) -> str: ...
    def add(self, /, truth: ArrayLike, estimate: ArrayLike) -> NDArray[float64]:
        """
        ADD: average distance of the points under both poses (Hinterstoisser et al. 2012).
        """
    def add_or_add_s(self, /, truth: ArrayLike, estimate: ArrayLike, symmetric: bool) -> NDArray[float64]:
        """
        ADD-(S): ADD-S for symmetric objects, ADD for others.
        """
    def add_s(self, /, truth: ArrayLike, estimate: ArrayLike) -> NDArray[float64]:
        """
        ADD-S, also ADI: average distance of the points under the true pose to the nearest point
        under the estimated one.
        """
    def mspd(self, /, truth: ArrayLike, estimate: ArrayLike, camera: Camera, symmetries: Symmetries | None = None) -> NDArray[float64]:
        """
        MSPD: greatest distance of the points' pixels, px, for the symmetry where that is least
        (BOP); infinite where the lens cannot image a point.

        Parameters
        ----------
        truth, estimate
            Object frame to camera frame.
        """
    def mssd(self, /, truth: ArrayLike, estimate: ArrayLike, symmetries: Symmetries | None = None) -> NDArray[float64]:
        """
        MSSD: greatest distance of the points, for the symmetry where that is least (BOP).
        """

@final
class Symmetries:
    """
    Motions of an object that do not change how it looks, the identity among them.
    """
    def __len__(self, /) -> int:
        """
        Number of motions.
        """
    def __new__(cls, /, discrete: ArrayLike | None = None, continuous: SupportsGetItem[int, tuple[ArrayLike, ArrayLike]] = ...) -> Symmetries:
        """
        The identity and the discrete symmetries, each followed by every turn about each axis, as in
        BOP's models_info.json.

        Parameters
        ----------
        discrete : array, (S, 4, 4)
            Without the identity, in the unit of the points.
        continuous
            Axis and a point on it, (3,) each.
        """
    def __repr__(self, /) -> str: ...

@final
class Tracks:
    """
    Gives objects numbers that stay theirs over time: `Estimator.predict(..., tracks=tracks)`.

    An object is the same as the nearest one of its class in earlier predictions, if it moved by less
    than the bound; numbers start at 1, and none is given twice. The cameras may move, and be others.
    Threads may share it: their predictions then run one after the other.
    """
    def __new__(cls, /, *, max_motion_m: SupportsFloat | SupportsIndex | None = None, patience: SupportsIndex = 30) -> Tracks:
        """
        Without any objects yet.

        Parameters
        ----------
        max_motion_m
            Farthest that an object moves between two predictions, metres; None: half its diameter.
        patience
            Predictions after which an object that is not found any more is forgotten.

        Raises
        ------
        ValueError
            Where `max_motion_m` is below 0 or not finite.
        """

def auc_exact(errors: ArrayLike, max: SupportsFloat | SupportsIndex) -> float | None:
    """
    Exact area under the recall curve from 0 to `max`, over `max`.
    """

def auc_poet(errors: ArrayLike, max: SupportsFloat | SupportsIndex) -> float | None:
    """
    The area of PoET's evaluation, `max` there being 0.1 m.
    """

def auc_posecnn(errors: ArrayLike, max: SupportsFloat | SupportsIndex) -> float | None:
    """
    The area of PoseCNN's and CosyPose's evaluations, `max` there being 0.1 m.
    """

def auroc(scores: ArrayLike, labels: ArrayLike) -> float | None:
    """
    Area under the receiver operating characteristic: the probability that of a sample with the
    label and one without it, the one with it has the greater score; equal scores count half (Hanley
    and McNeil 1982).

    Parameters
    ----------
    scores : array, (N,)
    labels : array, (N,)
        Whether each sample is one of those that should score high: bools, or 0 and 1.

    Returns
    -------
    0 to 1; None where all labels are alike.
    """

def average_recall(errors: ArrayLike, thresholds: SupportsGetItem[int, SupportsFloat | SupportsIndex]) -> float | None:
    """
    Mean of the recalls at several thresholds: BOP's average recall for one kind of error.
    """

def bop_results_line(scene_id: SupportsIndex, im_id: SupportsIndex, obj_id: SupportsIndex, score: SupportsFloat | SupportsIndex, cam_from_obj: ArrayLike, time_s: SupportsFloat | SupportsIndex) -> str:
    """
    The line of one pose, with its end.

    Parameters
    ----------
    cam_from_obj : array, (4, 4)
        Metres; written as rows of the rotation and millimetres.
    time_s
        What all poses of the image took, seconds; BOP's -1 where that is not known.
    """

def box_rays(camera: Camera, box: ArrayLike, ref_from_cam: ArrayLike) -> NDArray[float32] | None:
    """
    Lines of sight of a box: camera center o, direction d through the box's center, and how far the
    directions to its sides lie to the left and right, and above and below.

    Parameters
    ----------
    box
        x0, y0, x1, y1, px of the image.
    ref_from_cam : array, (4, 4)
        Metres.

    Returns
    -------
    array, (12,), float32
        [o, d, 10 e_x, 10 e_y] in the reference camera's frame; None where a pixel of it has no
        ray.
    """

def calibration(expected: ArrayLike, actual: ArrayLike, bins: SupportsIndex = ...) -> NDArray[float64]:
    """
    Mean expected and mean actual error in bins of equal count, least expected error first.

    Parameters
    ----------
    expected, actual : array, (N,)
    bins
        How many; as many as there are samples where those are fewer.

    Returns
    -------
    array, (bins, 2)
    """

def camera_rays(camera: Camera, strides: SupportsGetItem[int, SupportsIndex], *, net_size: tuple[SupportsIndex, SupportsIndex] | None = None) -> NDArray[float32]:
    """
    Direction in which each cell of the network's feature maps looks, in the camera's own frame.

    Parameters
    ----------
    strides
        Of the levels, network pixels per cell.
    net_size
        Width and height of the network's input, px, into which the image is scaled to fit; the
        image's own by default.

    Returns
    -------
    array, (N, 3), float32
        Of length 1, levels in the order of strides, each row by row; 0 for cells that lie in
        the padding or that no ray meets.
    """

def check_request(text: str) -> None:
    """
    Refuses JSON that is no request.
    """

def correlation(x: ArrayLike, y: ArrayLike) -> float | None:
    """
    Pearson's correlation coefficient.

    Parameters
    ----------
    x, y : array, (N,)

    Returns
    -------
    -1 to 1; None where either side does not vary.
    """

def default_inference() -> str:
    """
    All inference settings without a bundle, as JSON.
    """

def deformable_sampling(value: ArrayLike, locations: ArrayLike, weights: ArrayLike, levels: SupportsGetItem[int, tuple[SupportsIndex, SupportsIndex]]) -> NDArray[float32]:
    """
    Weighted bilinear reads of a multi-level feature map (Zhu et al., "Deformable DETR", eq. 3).

    Parameters
    ----------
    value : array, (B, N, H, D)
        The cells of all levels, finest first, row by row.
    locations : array, (B, Q, H, L, K, 2)
        X and y from 0 to 1 over the full extent of a level; what is read outside is 0, and what
        is not finite contributes nothing.
    weights : array, (B, Q, H, L, K)
    levels
        Height and width of each level, cells.

    Returns
    -------
    array, (B, Q, H * D), float32
    """

def deformable_sampling_backward(value: NDArray[float32], locations: NDArray[float32], weights: NDArray[float32], levels: SupportsGetItem[int, tuple[SupportsIndex, SupportsIndex]], grad_out: NDArray[float32], grad_value: NDArray[float32], grad_locations: NDArray[float32], grad_weights: NDArray[float32]) -> None:
    """
    Gradients of what `deformable_sampling_forward` reads, from that of what it writes.

    Arrays are C-contiguous and of float32.

    Parameters
    ----------
    grad_out : array, (B, Q, H * D)
    grad_value, grad_locations, grad_weights
        Shaped as what they belong to, overwritten.

    Raises
    ------
    ValueError
        For an array of another kind or shape.
    """

def deformable_sampling_forward(value: NDArray[float32], locations: NDArray[float32], weights: NDArray[float32], levels: SupportsGetItem[int, tuple[SupportsIndex, SupportsIndex]], out: NDArray[float32]) -> None:
    """
    `deformable_sampling` into an array of the caller's: nothing is converted or copied.

    Arrays are C-contiguous and of float32, their shapes those of `deformable_sampling`.

    Parameters
    ----------
    out : array, (B, Q, H * D)
        Overwritten.

    Raises
    ------
    ValueError
        For an array of another kind or shape.
    """

def encode_rays(camera_rays: ArrayLike, ref_from_cam: ArrayLike, encoding: str = "plucker") -> NDArray[float32]:
    """
    Lines of sight in the reference camera's frame: unit direction d, origin o, moment d x o, as the
    paper prints it (textbooks write o x d).

    Parameters
    ----------
    camera_rays : array, (N, 3)
        Directions in the camera's frame; 0 where there is none.
    ref_from_cam : array, (4, 4)
        Metres.
    encoding
        "direction" [d], "origin_direction" [o, d], "plucker" [d, d x o] or "plucker_origin" [d,
        d x o, o].

    Returns
    -------
    array, (N, 3, 6 or 9), float32
        0 where there is no ray.
    """

def read_models_info(path: str | PathLike[str]) -> dict[int, ModelInfo]:
    """
    What models_info.json says of each object, by its number.

    Raises
    ------
    OSError
        For a file that cannot be read.
    ValueError
        For one that is not BOP's.
    """

def read_scene(folder: str | PathLike[str], *, whole: bool = False) -> list[Image]:
    """
    What is known of the images of a scene's folder, in the order of sensors and images; the images
    themselves are not opened.

    Parameters
    ----------
    whole
        Whether what is incomplete is refused, images that are listed but not unpacked and
        annotations without a camera, instead of left out.

    Raises
    ------
    OSError
        For a file that cannot be read.
    ValueError
        For one that is not BOP's.

    Warns
    -----
    MvtopWarning
        Of what is doubtful: rotations that were made exact, images that are missing, cameras in
        metres.
    """

def recall(errors: ArrayLike, threshold: SupportsFloat | SupportsIndex) -> float | None:
    """
    Share of errors below a threshold; of ADD at 0.1 diameters, the usual "ADD recall". None
    without errors; an object that was not found counts as infinity.
    """

def roc_curve(scores: ArrayLike, labels: ArrayLike) -> NDArray[float64]:
    """
    The characteristic of "the score is at least a threshold", whose area `auroc` is.

    Parameters
    ----------
    scores, labels : array, (N,)
        As of `auroc`.

    Returns
    -------
    array, (T + 1, 2)
        False and true positive rate, from (0, 0) to (1, 1), one for each of T different scores;
        a rate of no samples is 0.
    """

def rotation_error_deg(truth: ArrayLike, estimate: ArrayLike, symmetries: Symmetries | None = None) -> NDArray[float64]:
    """
    Least angle between the estimated rotation and a symmetric one of the true, degrees.

    Parameters
    ----------
    truth, estimate
        (..., 4, 4) poses or (..., 3, 3) rotations; one of the two may be a single one.

    Returns
    -------
    array, (...)
    """

def rotation_from_6d(values: ArrayLike) -> NDArray[float64]:
    """
    Rotations from six numbers (Zhou et al. 2019): a, then b; columns x = a/|a|,
    z = (x × b)/|x × b|, y = z × x.

    Parameters
    ----------
    values : array, (..., 6)

    Returns
    -------
    array, (..., 3, 3)

    Raises
    ------
    ValueError
        Where a or b is 0, or the two are parallel.
    """

def run_cli(args: SupportsGetItem[int, str], shipped: str | PathLike[str], library: str | PathLike[str] | None = None) -> int:
    """
    The command line `mvtop-cli`: `args` begin with the program's name. Returns the exit code.

    Parameters
    ----------
    shipped
        The folder with the package's model and example.
    library
        Of ONNX Runtime, used where none is named; searched for by default.
    """

def score_results(dataset: str | PathLike[str], predictions: SupportsGetItem[int, str | PathLike[str]], *, split: str, targets: str | PathLike[str] | None, sensor: str | None, objects: SupportsGetItem[int, SupportsIndex] | None, names: SupportsGetItem[int, tuple[str, SupportsIndex]], vsd_delta_mm: SupportsFloat | SupportsIndex, report: str | PathLike[str] | None, force: bool) -> str:
    """
    Scores of results in BOP's format as one line of JSON, see `mvtop.bop.evaluate`.

    Parameters
    ----------
    names
        Ids of objects that the files give by name.
    report
        Folder for results and pages.

    Raises
    ------
    ValueError
        For what is refused.
    """

def set_num_threads(count: SupportsIndex) -> None:
    """
    Sets the number of threads that mvtop's own computations use, in this process and those that are
    forked from it. A network's are chosen where it is loaded.

    Parameters
    ----------
    count
        0 for one per processor, as it is at first; 1024 at most.

    Raises
    ------
    ValueError
        For more.
    """

def translation_error(truth: ArrayLike, estimate: ArrayLike, symmetries: Symmetries | None = None) -> NDArray[float64]:
    """
    Least distance between the estimated origin and a symmetric one of the true, in the unit of the
    poses.

    Parameters
    ----------
    truth, estimate : array, (..., 4, 4)
        One of the two may be a single one.

    Returns
    -------
    array, (...)
    """

def vsd(estimate: ArrayLike, truth: ArrayLike, measured: ArrayLike, camera: Camera, *, delta: SupportsFloat | SupportsIndex, taus: SupportsGetItem[int, SupportsFloat | SupportsIndex] | None = None, diameter: SupportsFloat | SupportsIndex | None = None) -> list[float]:
    """
    VSD: share of the visible pixels of both poses where the object's surfaces do not coincide
    (BOP).

    Parameters
    ----------
    estimate, truth : array, (H, W)
        Depth images of the object, see Mesh.depth.
    measured : array, (H, W)
        Depth image of the scene, 0 where nothing was measured.
    delta
        How far a surface may lie behind the measured one and still be seen; BOP: 15 mm.
    taus
        Misalignment tolerances; BOP's shares of the diameter by default.
    diameter
        Divides distances where given, as BOP does.

    Returns
    -------
    One number for each tolerance, 0 to 1.
    """

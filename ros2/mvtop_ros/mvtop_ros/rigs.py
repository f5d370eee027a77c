"""From calibration messages to cameras."""

import numpy as np

import mvtop

# Of ROS's names for lenses: mvtop's, and the numbers of coefficients.
_LENSES = {
    "plumb_bob": ("pinhole", (0, 4, 5)),
    "rational_polynomial": ("pinhole", (8, 12, 14)),
    "equidistant": ("fisheye", (4,)),
    "fisheye": ("fisheye", (4,)),
    "": ("pinhole", (0,)),
}


def camera_of(camera_id, info, world_from_cam, rectified=False):
    """A `mvtop.Camera` of a `sensor_msgs/CameraInfo`.

    - world_from_cam: (4, 4), of the frame in the message's header, metres
    - rectified: whether images are rectified: then its projection counts, without distortion
    """
    name = f"camera_info of `{camera_id}`"
    region = info.roi
    whole = (region.width, region.height) in ((0, 0), (info.width, info.height))
    if max(info.binning_x, info.binning_y) > 1 or not whole:
        raise ValueError(
            f"{name}: expected a whole image without binning, got binning "
            f"{info.binning_x}x{info.binning_y} and a region of {region.width}x{region.height} px; "
            "publish the calibration of the images as they are"
        )
    K = np.array(info.k, np.float64).reshape(3, 3)
    lens, distortion = "pinhole", []
    if rectified:
        projection = np.array(info.p, np.float64).reshape(3, 4)
        if projection[:, 3].any():
            raise ValueError(
                f"{name}: expected a projection about the camera's own center, got one of a stereo "
                "pair, whose frame is not known; use the images as they are, or give a rig file"
            )
        K = projection[:, :3]
        rect_from_cam = np.array(info.r, np.float64).reshape(3, 3)
        if rect_from_cam.any():  # all 0 where it is not set
            world_from_cam = world_from_cam.copy()
            world_from_cam[:3, :3] = world_from_cam[:3, :3] @ rect_from_cam.T
    else:
        if info.distortion_model not in _LENSES:
            known = ", ".join(lens for lens in _LENSES if lens)
            raise ValueError(
                f"{name}: expected distortion_model of {known}, got `{info.distortion_model}`"
            )
        lens, counts = _LENSES[info.distortion_model]
        distortion = list(info.d)
        if len(distortion) not in counts:
            raise ValueError(
                f"{name}: expected {' or '.join(map(str, counts))} coefficients for "
                f"`{info.distortion_model}`, got {len(distortion)}"
            )
    if not K.any():
        raise ValueError(f"{name}: expected a calibrated camera, got none; calibrate it")
    return mvtop.Camera(
        K, (info.width, info.height), distortion=distortion, model=lens,
        world_from_cam=world_from_cam, id=camera_id,
    )  # fmt: skip


def rig_of(cameras):
    """A rig of cameras whose units are known, in their order."""
    return mvtop.Rig(list(cameras), trust_unit=True)

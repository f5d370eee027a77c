"""MuJoCo rendering through exact OpenCV cameras: RGB with depth in one pass, and segmentation."""

import mujoco
import numpy as np

NEAR, FAR = 0.05, 20.0  # m; planes may be set nearer and farther
GROUP = 2  # geom group of the object, to render it alone


class Renderer:
    """Off-screen renderer of one compiled model at a fixed image size."""

    def __init__(
        self, model: mujoco.MjModel, width: int, height: int, gl: mujoco.GLContext, near=NEAR,
        far=FAR,
    ):  # fmt: skip
        self.model, self.width, self.height, self.near, self.far = model, width, height, near, far
        gl.make_current()
        self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        self._scene = mujoco.MjvScene(model, maxgeom=1000)
        # Scans with holes, and triangles that are wound the wrong way, have another side as well.
        self._scene.flags[mujoco.mjtRndFlag.mjRND_CULL_FACE] = False
        self._option, self._alone = mujoco.MjvOption(), mujoco.MjvOption()
        self._alone.geomgroup[:] = np.arange(len(self._alone.geomgroup)) == GROUP
        self._rect = mujoco.MjrRect(0, 0, width, height)

    def close(self):
        self._context.free()

    def aim(self, data: mujoco.MjData, k: np.ndarray, cam_from_world: np.ndarray, alone=False):
        """Set the camera; `k` [3, 3] with pixel centers at integers. `alone`: only the object."""
        # A renderer that was made since has bound its own buffer.
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)
        option = self._alone if alone else self._option
        mujoco.mjv_updateScene(
            self.model, data, option, None, mujoco.MjvCamera(),
            mujoco.mjtCatBit.mjCAT_ALL.value, self._scene,
        )  # fmt: skip
        fx, f, cx, cy = k[0, 0], k[1, 1], k[0, 2] + 0.5, k[1, 2] + 0.5
        rotation = cam_from_world[:3, :3]
        center = -rotation.T @ cam_from_world[:3, 3]
        for gl_camera in self._scene.camera:  # both eyes: mono rendering averages them
            gl_camera.pos[:] = center
            gl_camera.forward[:] = rotation[2]
            gl_camera.up[:] = -rotation[1]
            gl_camera.frustum_near, gl_camera.frustum_far = self.near, self.far
            gl_camera.frustum_top = cy / f * self.near
            gl_camera.frustum_bottom = -(self.height - cy) / f * self.near
            gl_camera.frustum_center = (self.width / 2 - cx) / fx * self.near
            # 0: left and right follow from the aspect ratio, which makes the pixels square.
            gl_camera.frustum_width = 0 if fx == f else self.width / 2 / fx * self.near
            gl_camera.orthographic = 0

    def rgb_depth(self) -> tuple[np.ndarray, np.ndarray]:
        """RGB [H, W, 3] uint8 and depth along the optical axis [H, W] in metres."""
        rgb = np.empty((self.height, self.width, 3), np.uint8)
        z = np.empty((self.height, self.width), np.float32)
        mujoco.mjr_render(self._rect, self._scene, self._context)
        mujoco.mjr_readPixels(rgb, z, self._rect, self._context)
        return rgb[::-1], self._metres(z)

    def outline_pixels(self, data, k, cam_from_world, center, geom: int | None = None) -> int:
        """Pixels of the object if nothing hid it and the image did not end.

        center  [2] px, where the object projects to in the image of `k`
        geom    one of several objects; all that is in `GROUP` if left out
        """
        k = k.copy()  # the same camera, its window moved by whole pixels onto the object
        k[:2, 2] += np.round(np.array([self.width, self.height]) / 2 - center)
        groups = self.model.geom_group.copy()
        if geom is not None:
            self.model.geom_group[groups == GROUP] = GROUP + 1
            self.model.geom_group[geom] = GROUP
        self.aim(data, k, cam_from_world, alone=True)
        self.model.geom_group[:] = groups
        return int((self.geom_ids() >= 0).sum())

    def geom_ids(self) -> np.ndarray:
        """Geom id per pixel [H, W], -1 where there is none."""
        return self._segment(None)

    def geom_ids_depth(self) -> tuple[np.ndarray, np.ndarray]:
        """Geom ids, and the depth [H, W] in metres of the same geoms: no pixel mixes two."""
        z = np.empty((self.height, self.width), np.float32)
        return self._segment(z), self._metres(z)

    def _metres(self, z: np.ndarray) -> np.ndarray:
        if self._context.readDepthMap == mujoco.mjtDepthMap.mjDEPTH_ZEROFAR:
            z = 1.0 - z
        near, far = self.near, self.far
        return (near * far / (far - z.astype(np.float64) * (far - near)))[::-1]

    def _segment(self, z: np.ndarray | None) -> np.ndarray:
        flags = self._scene.flags
        flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = flags[mujoco.mjtRndFlag.mjRND_IDCOLOR] = True
        image = np.empty((self.height, self.width, 3), np.uint8)
        mujoco.mjr_render(self._rect, self._scene, self._context)
        mujoco.mjr_readPixels(image, z, self._rect, self._context)
        flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = flags[mujoco.mjtRndFlag.mjRND_IDCOLOR] = False
        index = image[::-1].astype(np.int32) @ np.array([1, 256, 65536], np.int32)
        table = np.full(self._scene.ngeom + 1, -1, np.int32)
        for geom in self._scene.geoms[: self._scene.ngeom]:
            if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM and geom.segid >= 0:
                table[geom.segid + 1] = geom.objid
        return table[np.minimum(index, self._scene.ngeom)]

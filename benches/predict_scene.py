"""Scenes for `predict.py`: parts of a shipped bundle on a table, and a ring of cameras around it.

Parts lie on a fixed grid, in any rotation; so only their number changes from scene to scene.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import trimesh
from mvtop_train.data import meshfile, objects
from mvtop_train.synthesis.gl import open_gl
from mvtop_train.synthesis.parts import Part
from mvtop_train.synthesis.render import Renderer, mujoco

GRID = (6, 5)  # places of parts
SPACING = 0.26  # m between places
DISTANCE = 2.4  # m of each camera from the middle of the table
ELEVATION = 55  # degrees of the cameras over the table
CAMERAS = 8
FIELD = 46  # degrees that the longer side of an image shows
FINER = 2  # times that each triangle of a mesh is split in four, as its colors are of its vertices


@dataclass(frozen=True)
class Camera:
    """A pinhole camera: `k` [3, 3] in px with pixel centers at integers, `cam_from_world` in m."""

    id: str
    k: np.ndarray
    cam_from_world: np.ndarray


def ring(width: int, height: int) -> list[Camera]:
    """Cameras around the table; the first 2 or 4 of them are spread evenly, too."""
    focal = width / 2 / np.tan(np.radians(FIELD / 2))
    k = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
    cameras = []
    for number, turn in enumerate([0, 4, 2, 6, 1, 5, 3, 7]):
        around, above = np.radians([360 / CAMERAS * turn, ELEVATION])
        level = np.array([np.cos(around), np.sin(around), 0]) * np.cos(above)
        center = DISTANCE * (level + [0, 0, np.sin(above)])
        ahead = -center / DISTANCE
        right = np.cross(ahead, [0, 0, 1])
        right /= np.linalg.norm(right)
        cam_from_world = np.eye(4)
        cam_from_world[:3, :3] = [right, np.cross(ahead, right), ahead]
        cam_from_world[:3, 3] = -cam_from_world[:3, :3] @ center
        cameras.append(Camera(f"cam{number}", k, cam_from_world))
    return cameras


def rig(cameras: list[Camera], width: int, height: int) -> dict:
    """The rig file of some cameras."""
    entries = [
        {
            "id": camera.id, "width": width, "height": height, "model": "pinhole",
            "fx": camera.k[0, 0], "fy": camera.k[1, 1], "cx": camera.k[0, 2], "cy": camera.k[1, 2],
            "T_cam_world": camera.cam_from_world.tolist(),
        }
        for camera in cameras
    ]  # fmt: skip
    return {
        "format": "mvtop-rig", "version": 1, "unit": "m", "reference": cameras[0].id,
        "cameras": entries,
    }  # fmt: skip


class Table:
    """Renders scenes of a bundle's parts."""

    def __init__(self, bundle: Path):
        manifest = json.loads((bundle / "model.json").read_text())
        self.classes = [entry["name"] for entry in manifest["classes"]]
        self.parts = [self._part(bundle, index) for index in range(len(self.classes))]
        self.gl = open_gl()

    def _part(self, bundle: Path, index: int) -> Part:
        mesh = meshfile.load_mesh(bundle / f"{self.classes[index]}.mesh.ply", "m")
        vertices, faces = mesh.vertices, mesh.faces
        colors = {"color": np.asarray(mesh.visual.vertex_colors, float)}
        for _ in range(FINER):
            vertices, faces, colors = trimesh.remesh.subdivide(vertices, faces, None, colors)
        colors = colors["color"].astype(np.uint8)
        mesh = trimesh.Trimesh(vertices, faces, vertex_colors=colors, process=False)
        return Part(mesh, objects.from_mesh(mesh, index + 1, self.classes[index]))

    def render(
        self, seed: int, count: int, size: tuple[int, int], cameras: int
    ) -> list[np.ndarray]:
        """RGB images [H, W, 3] of the first `cameras` of the ring, of a scene of `count` parts."""
        rng = np.random.default_rng([seed, count])
        width, height = size
        places = rng.permutation(GRID[0] * GRID[1])[:count]
        xml, files, used = [], {}, set()
        for number, place in enumerate(places):
            part = self.parts[number % len(self.parts)]
            if part.name not in used:
                used.add(part.name)
                xml.append(part.asset())
                files |= part.files(1.0)
            column, row = place % GRID[0], place // GRID[0]
            at = SPACING * np.array([column - (GRID[0] - 1) / 2, row - (GRID[1] - 1) / 2, 0])
            xml.append(part.body(rng, f"{part.name}_{number}", at))
        gray = rng.uniform(0.3, 0.7, 3)
        floor = f"""<visual><headlight ambient="0.4 0.4 0.4" diffuse="0.6 0.6 0.6"/>
            <global offwidth="{width}" offheight="{height}"/></visual>
          <worldbody><light pos="0.5 0.3 3" dir="-0.1 -0.1 -1" diffuse="0.4 0.4 0.4"/>
          <geom name="floor" type="plane" size="4 4 0.1" pos="0 0 -0.15"
            rgba="{" ".join(f"{x:.2f}" for x in gray)} 1"/></worldbody>"""
        model = mujoco.MjModel.from_xml_string(f"<mujoco>{floor}{''.join(xml)}</mujoco>", files)
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        renderer = Renderer(model, width, height, self.gl)
        try:
            images = []
            for camera in ring(width, height)[:cameras]:
                renderer.aim(data, camera.k, camera.cam_from_world)
                images.append(renderer.rgb_depth()[0].copy())
            return images
        finally:
            renderer.close()


def smaller(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """An image as a camera of fewer pixels would take it."""
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)

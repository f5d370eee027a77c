"""Object coordinates for a data set of others, from its poses and its mesh.

    mvtop-train coordinates --data data/lm --split train_real --object 5

Renders the mesh (models/, PLY) in each image's pose and writes `coords/` beside `rgb/`, as `bop.py`
describes it. BOP's `mask_visib/`, where it is there, tells which pixels show the object; without it
hidden parts are coded as if they were seen, so it suits images in which nothing hides the object.
What imports MuJoCo is imported late: `gl.open_gl` says first where OpenGL is missing.
"""

from pathlib import Path

import cv2
import numpy as np
from tqdm import tqdm

from ..data import bop, objects, rendered
from ..errors import argument_parser, command
from .gl import open_gl


class CoordinateRenderer:
    """Renders one object, at the origin of its world, through any pinhole."""

    def __init__(self, root: Path, obj: objects.Object):
        self.gl, self.renderers = open_gl(), {}
        import mujoco

        from .parts import Kit, Part

        mesh = objects.read_mesh(root, obj.id)
        self.part = Part(mesh, obj)
        self.kit = Kit([self.part])
        body = self.part.body(np.random.default_rng(0), "one", np.zeros(3))
        xml = f"<mujoco>{self.part.asset()}{body}</mujoco>"
        self.model = mujoco.MjModel.from_xml_string(xml, self.kit.files)
        self.data = mujoco.MjData(self.model)
        self.data.qpos[:] = [0, 0, 0, 1, 0, 0, 0]
        mujoco.mj_forward(self.model, self.data)

    def __call__(self, k, cam_from_obj, size: tuple[int, int]) -> np.ndarray:
        """Object coordinates [h, w, 3] in metres, NaN off the object. size  (w, h), px"""
        from .render import Renderer

        if size not in self.renderers:
            self.model.vis.global_.offwidth, self.model.vis.global_.offheight = size
            self.renderers[size] = Renderer(self.model, *size, self.gl, self.kit.near)
        scaled = cam_from_obj.copy()
        scaled[:3, 3] *= self.kit.scale
        self.renderers[size].aim(self.data, k, scaled)
        ids, depth = self.renderers[size].geom_ids_depth()
        mask = ids >= 0
        seen = rendered.Seen(self.part.obj, np.eye(4), mask, int(mask.sum()))
        view = rendered.View(k, cam_from_obj, [seen], depth=depth / self.kit.scale)
        return rendered.object_coordinates(view, seen)


def write(image: bop.Image, render: CoordinateRenderer, obj: objects.Object) -> bool:
    """Write the coordinates of one image; whether its data set says what is visible."""
    height, width = cv2.imread(str(image.path), cv2.IMREAD_COLOR).shape[:2]
    coords = render(image.k, image.cam_from_obj, (width, height))
    folder, stem = image.path.parents[1], image.path.stem
    visible = folder / "mask_visib" / f"{stem}_{image.annotation:06d}.png"
    masked = visible.exists()
    if masked:
        coords[cv2.imread(str(visible), cv2.IMREAD_GRAYSCALE) == 0] = np.nan
    x, y = (0, 0) if image.visible_box is None else np.maximum(image.visible_box[:2], 0)
    code = bop.encode_coords(coords, obj.extent_m)[int(y) :, int(x) :]
    (folder / "coords").mkdir(exist_ok=True)
    bop.write_image(folder / "coords" / f"{stem}.png", code[:, :, ::-1])
    return masked


@command
def main():
    parser = argument_parser(__doc__)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--split", default="train")
    parser.add_argument("--object", type=int, metavar="ID", help="of the objects in --data")
    args = parser.parse_args()
    obj = objects.read(args.data, args.object)
    images = [
        image
        for scene in bop.read_split(args.data, args.split, obj).values()
        for image in scene
        if image.coords_path is None
    ]
    render = CoordinateRenderer(args.data, obj)
    masked = sum(write(image, render, obj) for image in tqdm(images, unit="image"))
    print(f"{args.data}/{args.split}: {len(images)} images, {masked} with mask_visib")


if __name__ == "__main__":
    main()

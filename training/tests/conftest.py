import os

os.environ.setdefault("MUJOCO_GL", "egl")  # read when MuJoCo is imported

import numpy as np  # noqa: E402
import pytest  # noqa: E402
import torch  # noqa: E402

from mvtop_train.data import mvball, objects  # noqa: E402
from mvtop_train.data.boxes import amodal_boxes  # noqa: E402
from mvtop_train.network import config  # noqa: E402
from mvtop_train.network.model import Mvtop  # noqa: E402
from mvtop_train.network.views import Pictures, Views  # noqa: E402

MVBALL = objects.classes_of(objects.ball())
WHOLE = {"closeup": 0, "closeup_strides": ()}  # poses from whole images


def drawn(**changes) -> Mvtop:
    """The tiny network with random weights, made to use all its inputs."""
    torch.manual_seed(3)
    model = Mvtop(config.preset("tiny", MVBALL, **changes)).eval()
    for name, parameter in model.named_parameters():
        if "offsets.weight" in name or "weights.weight" in name:
            torch.nn.init.normal_(parameter, std=0.05)
    return model


@pytest.fixture(scope="session")
def tiny():
    """The tiny network, of whole images."""
    return drawn(**WHOLE)


@pytest.fixture(scope="session")
def closeups():
    """The tiny network, of close-ups, with random weights."""
    torch.manual_seed(2)
    return Mvtop(config.preset("tiny", MVBALL)).eval()


def random_pose(rng: np.random.Generator, translation=(0.0, 0.0, 0.0)) -> np.ndarray:
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    pose = np.eye(4)
    pose[:3, :3] = q * np.sign(np.linalg.det(q))
    pose[:3, 3] = translation
    return pose


def random_views(model_config, views: int, seed: int = 0, world=None) -> Views:
    """Views of one object from random cameras, with noise for images."""
    rng = np.random.default_rng(seed)
    cam_from_obj = np.stack(
        [random_pose(rng, [*rng.uniform(-0.1, 0.1, 2), rng.uniform(0.5, 0.8)]) for _ in range(4)]
    )
    world_from_obj = random_pose(rng, rng.normal(size=3))
    if world is not None:
        world_from_obj = world @ world_from_obj
    cam_from_world = cam_from_obj @ np.linalg.inv(world_from_obj)
    ref_from_cam = cam_from_world[0] @ np.linalg.inv(cam_from_world)
    k = np.array([[140.0, 0, 79.5], [0, 140, 63.5], [0, 0, 1]])
    k = np.stack([k * np.diag([s, s, 1]) + k * 0 for s in np.ones(4)])
    boxes = amodal_boxes(mvball.bounding_points(), k, cam_from_obj)
    images = rng.normal(size=(4, 3, model_config.height, model_config.width))
    n = sum(r * c for r, c in model_config.level_shapes())

    def tensor(x):
        return torch.tensor(np.asarray(x)[None, :views], dtype=torch.float32)

    return Views(
        shown=Pictures(tensor(images)),
        k=tensor(k),
        ref_from_cam=tensor(ref_from_cam),
        boxes=tensor(boxes)[:, :, None],
        valid=torch.ones(1, views, 1),
        class_index=torch.zeros(1, 1, dtype=torch.long),
        inside=torch.ones(1, views, n),
    )

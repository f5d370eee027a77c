"""Write the parity fixtures that the Rust tests read: one file per stage, same name as the stage.

    python -m mvtop_train.fixtures --out fixtures [--weights runs/tiny/last.pt] [--check]

Inputs and outputs at full precision; the metadata holds seed and versions. `--check` compares
with the files that are there instead of writing. With `--weights` the `tiny` bundle is exported
anew and its sample shrunk to the network's size from `--sample`.
"""

import argparse
import json
import platform
import sys
from pathlib import Path

import cv2
import numpy as np
import torch
from safetensors import safe_open
from safetensors.torch import save_file

from . import closeup, export, pose, rays, reference
from .checkpoint import load_weights
from .sampling import sample_torch

SEED = 20261121


def sampling_fixture() -> dict:
    """Deformable sampling and its gradients in float64, with points outside and on borders."""
    shapes = [(6, 9), (3, 5), (2, 2)]
    b, h, d, q, k = 2, 3, 5, 7, 4
    n = sum(r * c for r, c in shapes)
    value = torch.randn(b, n, h, d, dtype=torch.float64)
    locations = torch.rand(b, q, h, len(shapes), k, 2, dtype=torch.float64) * 1.6 - 0.3
    locations[0, 0, 0, 0] = torch.tensor([[0.0, 0.0], [1.0, 1.0], [0.5, 0.5], [-0.1, 0.5]])
    weights = torch.rand(b, q, h, len(shapes), k, dtype=torch.float64)
    # The kernel works in float32: let both sides start from the same numbers.
    inputs = [x.float().double().requires_grad_() for x in (value, locations, weights)]
    out = sample_torch(*inputs, shapes)
    grad_out = torch.randn_like(out).float().double()
    grads = torch.autograd.grad(out, inputs, grad_out)
    names = ("value", "locations", "weights")
    return {
        **dict(zip(names, inputs, strict=True)),
        "level_shapes": torch.tensor(shapes),
        "out": out,
        "grad_out": grad_out,
        **{f"grad_{name}": g for name, g in zip(names, grads, strict=True)},
    }


def _random_pose() -> torch.Tensor:
    m = torch.eye(4, dtype=torch.float64)
    m[:3, :3] = pose.rotation_from_6d(torch.randn(6, dtype=torch.float64))
    m[:3, 3] = torch.randn(3, dtype=torch.float64)
    return m


def rays_fixture() -> dict:
    """Cell rays of three pinholes, the four encodings, and box rays."""
    shapes, strides = [(6, 8), (3, 4)], [8, 16]
    k = torch.tensor([[[300.0, 0, 31.5], [0, 310, 23.5], [0, 0, 1]]], dtype=torch.float64)
    k = k.repeat(3, 1, 1)
    k[1, 0, 0], k[2, :2, 2] = 45.0, torch.tensor([10.0, 40.0])
    ref_from_cam = torch.stack([torch.eye(4, dtype=torch.float64), _random_pose(), _random_pose()])
    pixels = rays.cell_centers(shapes, strides).double()
    camera_rays = rays.unproject(k, pixels)
    camera_rays[2, 5] = 0  # a cell without a ray
    boxes = torch.tensor([[[10.0, 5, 30, 22], [40, 30, 63.5, 47.5]]], dtype=torch.float64)
    boxes = boxes.repeat(3, 1, 1)
    out = {"k": k, "ref_from_cam": ref_from_cam, "pixels": pixels, "camera_rays": camera_rays}
    for name in ("direction", "origin_direction", "plucker", "plucker_origin"):
        out[name] = rays.encode(camera_rays, ref_from_cam, name)
    return {**out, "boxes": boxes, "box_rays": rays.box_rays(k, boxes, ref_from_cam)}


def closeup_fixture() -> dict:
    """Close-ups of an image: enlarged, at its corner, and reduced."""
    height, width, size = 60, 80, 16
    v, u = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    image = torch.stack([u * 3, v * 4, 127 + 100 * torch.sin(u / 7 + v / 5)], -1).byte()
    k = np.array([[90.0, 0, 38.2], [0, 93.0, 31.7], [0, 0, 1]])
    boxes = np.array([[30.0, 22, 38, 31], [0, 40, 12, 59], [20, 5, 70, 50.5]])
    views = [closeup.camera_of(k, box, size) for box in boxes]
    taken = [closeup.take(image.numpy(), k, view, size) for view in views]
    out = {
        "k": k,
        "boxes": boxes,
        "focals": np.array([view.k[0, 0] for view in views]),
        "close_boxes": np.stack([view.box for view in views]),
        "close_from_cam": np.stack([view.close_from_cam for view in views]),
        "pictures": np.stack([picture for picture, _ in taken]),
        "on_image": np.stack([on_image for _, on_image in taken]).astype(np.uint8),
    }
    return {"image": image, **{name: torch.from_numpy(x) for name, x in out.items()}}


def pose_fixture() -> dict:
    """Rotations from six numbers, and errors between poses."""
    six = torch.randn(16, 6, dtype=torch.float64)
    six[0] = torch.tensor([1.0, 2, 2, 0, 3, 4])
    rotation = pose.rotation_from_6d(six)
    t = torch.randn(16, 3, dtype=torch.float64)
    points = torch.randn(50, 3, dtype=torch.float64) * 0.06
    other, t_other = rotation.roll(1, 0), t.roll(1, 0)
    cos = ((rotation * other).sum((-2, -1)) - 1) / 2
    return {
        "six": six,
        "rotation": rotation,
        "translation": t,
        "points": points,
        "angle_deg": torch.rad2deg(cos.clamp(-1, 1).acos()),
        "add": pose.add_error(points, rotation, t, other, t_other),
    }


def network_fixture(model, sample: Path) -> dict:
    """Every stage's input and output for 1 to 4 views of one sample, given its true boxes."""
    cameras, images, boxes, _ = reference.load_sample(sample)
    out = {}
    for views in range(1, len(cameras) + 1):
        result = reference.predict(model, cameras[:views], images[:views], boxes[:views])
        out |= {f"{name}.{views}": x for name, x in result.items()}
        out[f"rotation.{views}"] = pose.rotation_from_6d(result["rotation_6d"].double())
    return out


def shrink_sample(source: Path, out: Path, factor: int):
    """A sample with images and intrinsics `factor` times smaller."""
    out.mkdir(parents=True, exist_ok=True)
    rig = json.loads((source / "rig.json").read_text())
    truth = json.loads((source / "truth.json").read_text())
    for camera in rig["cameras"]:
        name = f"{camera['id']}.png"
        image = cv2.imread(str(source / name))
        size = camera["width"] // factor, camera["height"] // factor
        cv2.imwrite(str(out / name), cv2.resize(image, size, interpolation=cv2.INTER_AREA))
        camera["width"], camera["height"] = size
        camera["fx"], camera["fy"] = camera["fx"] / factor, camera["fy"] / factor
        for c in ("cx", "cy"):
            camera[c] = (camera[c] + 0.5) / factor - 0.5
    for item in truth["objects"]:
        item["boxes"] = {
            name: [(x + 0.5) / factor - 0.5 for x in box] for name, box in item["boxes"].items()
        }
    (out / "rig.json").write_text(json.dumps(rig, indent=1) + "\n")
    (out / "truth.json").write_text(json.dumps(truth, indent=1) + "\n")


def difference(path: Path, tensors: dict) -> float:
    """Largest absolute difference to a written fixture."""
    with safe_open(path, "pt") as file:
        if set(file.keys()) != set(tensors):
            return float("inf")
        return max(
            (file.get_tensor(n).double() - x.double()).abs().max().item()
            for n, x in tensors.items()
        )


def build(out: Path) -> dict[str, dict]:
    fixtures = {}
    for name, make in (
        ("sampling", sampling_fixture), ("rays", rays_fixture), ("pose", pose_fixture),
        ("closeup", closeup_fixture),
    ):  # fmt: skip
        torch.manual_seed(SEED)
        fixtures[name] = make()
    model, _, _ = load_weights(out / "tiny" / "weights.pt")
    fixtures["network"] = network_fixture(model, out / "tiny" / "sample")
    return {
        name: {key: x.detach().contiguous() for key, x in tensors.items()}
        for name, tensors in fixtures.items()
    }


def update_tiny(out: Path, weights: Path, sample: Path):
    """Export the `tiny` bundle and keep its weights beside it."""
    model, config, step = load_weights(weights)
    factor = 640 // config.width
    shrink_sample(sample, out / "tiny" / "sample", factor)
    state = torch.load(weights, map_location="cpu", weights_only=True)
    torch.save({n: state[n] for n in ("config", "average", "step")}, out / "tiny" / "weights.pt")
    provenance = {"trained_steps": step, "torch": torch.__version__}
    export.write_bundle(model, out / "tiny", provenance)
    export.write_bundle(model, out / "tiny" / "portable", provenance, portable=True)


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("fixtures"))
    parser.add_argument("--weights", type=Path, help="last.pt of a `tiny` run")
    parser.add_argument("--sample", type=Path, help="four-view sample folder to shrink")
    parser.add_argument("--check", action="store_true")
    args = parser.parse_args()
    if args.weights:
        update_tiny(args.out, args.weights, args.sample)
    metadata = {
        "seed": str(SEED), "torch": torch.__version__, "numpy": np.__version__,
        "python": platform.python_version(),
    }  # fmt: skip
    failed = False
    for name, tensors in build(args.out).items():
        path = args.out / f"{name}.safetensors"
        if not args.check:
            save_file(tensors, path, metadata)
            continue
        gap = difference(path, tensors)
        # Other processors and library versions round differently; a changed model differs by more.
        failed |= gap > 1e-3
        print(f"{path}: largest difference {gap:.1e}")
    sys.exit(failed)


if __name__ == "__main__":
    main()

"""A bundle: `model.json` beside two or three ONNX graphs.

`features.onnx` runs once on all views, `decoder.onnx` once per reference camera; between them
Rust finds the boxes and computes the lines of sight. Networks with close-ups have a third,
`closeup.onnx`, which runs once on these, and the first then only detects. The deformable sampling
is the custom operator `mvtop::DeformableSampling`;
portable bundles have standard operators instead.
"""

import contextlib
import copy
import hashlib
import json
from pathlib import Path

import numpy as np
import onnx
import torch
from torch import nn

from ..data import objects
from ..errors import UserError
from ..network import sampling
from ..network.decoder import Boxes
from ..network.model import Mvtop

OPSET = 17


class ExportedFeatures(nn.Module):
    """images [V, 3, H, W], camera_rays [V, N, 3] -> memory, det_scores, det_boxes."""

    def __init__(self, model: Mvtop):
        super().__init__()
        self.features = model.features

    def forward(self, images, camera_rays):
        levels = self.features.backbone(images)
        scores, boxes = self.features.detector(levels[0])
        memory = self.features.encoder(self.features.pose_levels(levels), camera_rays)
        return memory, scores.sigmoid(), boxes


class ExportedDetector(nn.Module):
    """images [V, 3, H, W] -> det_scores, det_boxes."""

    def __init__(self, model: Mvtop):
        super().__init__()
        self.backbone, self.detector = model.features.backbone, model.features.detector

    def forward(self, images):
        scores, boxes = self.detector(self.backbone(images)[0])
        return scores.sigmoid(), boxes


class ExportedCloseUps(nn.Module):
    """images [P, 3, S, S], camera_rays [P, N, 3] -> memory."""

    def __init__(self, model: Mvtop):
        super().__init__()
        self.features = model.features

    def forward(self, images, camera_rays):
        levels = self.features.pose_levels(self.features.backbone(images))
        return self.features.encoder(levels, camera_rays)


class ExportedDecoder(nn.Module):
    """One scene (no batch axis); see the inputs in `export_decoder`."""

    def __init__(self, model: Mvtop):
        super().__init__()
        self.decoder, self.shapes = model.decoder, model.config.decoder_shapes()

    def forward(self, memory, rays, centers, half_sizes, box_rays, valid, class_index):
        inputs = (x[None] for x in (centers, half_sizes, box_rays, valid))
        poses = self.decoder(
            memory[None], rays[None], Boxes(*inputs), class_index[None], self.shapes
        )
        return tuple(x[0] for x in poses[-1])


def _export(module, args, path: Path, inputs, outputs, axes):
    torch.onnx.export(
        module, args, str(path), input_names=inputs, output_names=outputs,
        dynamic_axes=axes, opset_version=OPSET, dynamo=False, do_constant_folding=True,
        custom_opsets={"mvtop": 1},
    )  # fmt: skip
    graph = onnx.load(str(path))
    graph.producer_name, graph.doc_string = "mvtop", ""
    onnx.save(graph, str(path))


def export_features(model: Mvtop, path: Path, views: int = 2):
    config = model.config
    n = sum(rows * columns for rows, columns in config.level_shapes())
    args = (torch.zeros(views, 3, config.height, config.width), torch.zeros(views, n, 3))
    names = ["images", "camera_rays"]
    outputs = ["memory", "det_scores", "det_boxes"]
    axes = {name: {0: "views"} for name in names + outputs}
    _export(ExportedFeatures(model).eval(), args, path, names, outputs, axes)


def export_detector(model: Mvtop, path: Path, views: int = 2):
    images = torch.zeros(views, 3, model.config.height, model.config.width)
    outputs = ["det_scores", "det_boxes"]
    axes = {name: {0: "views"} for name in ["images", *outputs]}
    _export(ExportedDetector(model).eval(), (images,), path, ["images"], outputs, axes)


def export_closeup(model: Mvtop, path: Path, pictures: int = 2):
    size = model.config.closeup
    n = sum(rows * columns for rows, columns in model.config.decoder_shapes())
    args = (torch.zeros(pictures, 3, size, size), torch.zeros(pictures, n, 3))
    names = ["images", "camera_rays"]
    axes = {name: {0: "pictures"} for name in [*names, "memory"]}
    _export(ExportedCloseUps(model).eval(), args, path, names, ["memory"], axes)


def store_in_half(path: Path):
    """Keep the large weights of a graph in half precision: half the file, computed in full."""
    graph = onnx.load(str(path))
    casts = []
    for tensor in graph.graph.initializer:
        values = onnx.numpy_helper.to_array(tensor)
        if values.dtype == np.float32 and values.size >= 1024:
            name = tensor.name
            tensor.CopyFrom(onnx.numpy_helper.from_array(values.astype(np.float16), f"{name}.half"))
            casts.append(
                onnx.helper.make_node("Cast", [f"{name}.half"], [name], to=onnx.TensorProto.FLOAT)
            )
    nodes = [*casts, *graph.graph.node]
    del graph.graph.node[:]
    graph.graph.node.extend(nodes)
    onnx.checker.check_model(graph)
    onnx.save(graph, str(path))


def export_decoder(model: Mvtop, path: Path, views: int = 2, queries: int = 2):
    config = model.config
    n = sum(rows * columns for rows, columns in config.decoder_shapes())
    v, q = views, queries
    args = {
        "memory": torch.randn(v, n, config.d_model),
        "rays": torch.randn(v, n, config.los_channels),
        "centers": torch.rand(v, q, 2),
        "half_sizes": torch.rand(v, q, 2) * 0.2,
        "box_rays": torch.randn(v, q, 12),
        "valid": torch.ones(v, q),
        "class_index": torch.zeros(q, dtype=torch.long),
    }
    outputs = ["rotation_6d", "translation", "sigma"]
    axes = {name: {0: "views"} for name in ("memory", "rays")}
    axes |= {n: {0: "views", 1: "objects"} for n in ("centers", "half_sizes", "box_rays", "valid")}
    axes |= {name: {0: "objects"} for name in ("class_index", *outputs)}
    _export(ExportedDecoder(model).eval(), tuple(args.values()), path, list(args), outputs, axes)


def fold_batch_norm(model: Mvtop) -> Mvtop:
    """A copy in which each batch normalisation is part of the convolution before it."""
    model = copy.deepcopy(model).eval()
    for module in model.modules():
        if isinstance(module, nn.Sequential):
            for i in range(len(module) - 1):
                pair = module[i], module[i + 1]
                if isinstance(pair[0], nn.Conv2d) and isinstance(pair[1], nn.BatchNorm2d):
                    module[i] = nn.utils.fuse_conv_bn_eval(*pair)
                    module[i + 1] = nn.Identity()
    return model


def _entry(path: Path) -> dict:
    content = path.read_bytes()
    return {"sha256": hashlib.sha256(content).hexdigest(), "bytes": len(content)}


def write_bundle(
    model: Mvtop, out: Path, provenance: dict, portable: bool = False,
    score_threshold: float = 0.3, obj: objects.Object | None = None,
    agree_threshold: float | None = None, half: bool = False,
):  # fmt: skip
    """Write every file of a bundle; `model.json` comes last. `obj`: the MV-ball if left out."""
    config = model.config
    obj = obj or objects.ball()
    if [c.name for c in config.classes] != [obj.name]:
        raise UserError(
            f"weights know {[c.name for c in config.classes]}, expected [{obj.name!r}]; "
            "fix: --data must name the data set that they were trained on"
        )
    out.mkdir(parents=True, exist_ok=True)
    model = fold_batch_norm(model)
    graphs = {"features": export_features, "decoder": export_decoder}
    if config.closeup:
        graphs |= {"features": export_detector, "closeup": export_closeup}
    with sampling.portable_export() if portable else contextlib.nullcontext():
        for name, export in graphs.items():
            export(model, out / f"{name}.onnx")
    if half:
        for name in graphs:
            store_in_half(out / f"{name}.onnx")
    rows = np.concatenate([obj.points.round(6), obj.colors.astype(int)], 1).tolist()
    rows = [[*row[:3], *(int(c) for c in row[3:])] for row in rows]
    points_file = f"{obj.name}.points.json"
    (out / points_file).write_text(json.dumps({"unit": "m", "points": rows}))
    files = [*(f"{name}.onnx" for name in graphs), points_file]
    agree = {} if agree_threshold is None else {"agree_threshold": agree_threshold}
    closeup = {"size": config.closeup, "strides": list(config.closeup_strides)}
    description = {
        "format": "mvtop-model",
        "version": 1,
        "preset": config.preset,
        "input": {
            "width": config.width, "height": config.height,
            "mean": list(config.mean), "std": list(config.std),
        },
        "strides": list(config.strides),
        "los_encoding": config.los_encoding,
        "classes": [
            {"id": c.id, "name": c.name, "diameter_m": c.diameter_m, "points": points_file}
            for c in config.classes
        ],
        "detector": {"score_threshold": score_threshold, **agree, "nms_iou": 0.5},
        **({"closeup": closeup} if config.closeup else {}),
        "graphs": {name: f"{name}.onnx" for name in graphs},
        "portable": portable,
        "files": {name: _entry(out / name) for name in files},
        "provenance": provenance,
    }  # fmt: skip
    (out / "model.json").write_text(json.dumps(description, indent=1) + "\n")

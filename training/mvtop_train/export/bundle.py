"""A bundle: `model.json` beside two or three ONNX graphs.

`features.onnx` detects in all views, `closeup.onnx` runs on close-ups of the boxes, `decoder.onnx`
once per anchor camera; between them Rust finds the boxes and computes the lines of sight. Preset
`lite` has no decoder: its close-ups give object coordinates. The deformable sampling is the custom
operator `mvtop::DeformableSampling`; portable bundles have standard operators instead. Meshes are
added by `mesh.py`.
"""

import contextlib
import copy
import hashlib
import io
import json
from pathlib import Path

import numpy as np
import onnx
import torch
from torch import nn

from .. import description
from ..data import objects
from ..errors import UserError
from ..network import sampling
from ..network.config import ObjectClass
from ..network.decoder import Boxes
from ..network.heads import Hypotheses
from ..network.model import Mvtop
from . import integers, self_test

OPSET = 17
LARGE = 1024  # weights of a tensor from which on it is worth storing them in fewer bits


class ExportedDetector(nn.Module):
    """images [V, 3, H, W] -> det_scores, det_boxes."""

    def __init__(self, model: Mvtop):
        super().__init__()
        self.features = model.features

    def forward(self, images):
        scores, boxes = self.features.detect(images)
        return scores.sigmoid(), boxes


class ExportedCloseUps(nn.Module):
    """images [P, 3, S, S], camera_rays [P, N, 3] -> memory."""

    def __init__(self, model: Mvtop):
        super().__init__()
        self.features = model.features

    def forward(self, images, camera_rays):
        return self.features.encoder(self.features.pose_levels(images), camera_rays)


class ExportedCoordinates(nn.Module):
    """images [P, 3, S, S] -> coordinates [P, 4, h, w]."""

    def __init__(self, model: Mvtop):
        super().__init__()
        self.features = model.features

    def forward(self, images):
        return self.features.describe(images)


class ExportedDecoder(nn.Module):
    """One scene (no batch axis); see the inputs in `_decoder_of`."""

    def __init__(self, model: Mvtop):
        super().__init__()
        self.decoder, self.shapes = model.decoder, model.config.decoder_shapes()

    def forward(self, memory, rays, centers, half_sizes, box_rays, valid, class_index):
        inputs = (x[None] for x in (centers, half_sizes, box_rays, valid))
        poses = self.decoder(
            memory[None], rays[None], Boxes(*inputs), class_index[None], self.shapes
        )
        poses = poses[-1]
        if isinstance(poses, Hypotheses):
            poses = (*poses.best(), *poses)
        return tuple(x[0] for x in poses)


def graph_of(module: nn.Module, inputs: dict, outputs: list[str], free: dict) -> onnx.ModelProto:
    """inputs: by name; free: the names of axes of any length, by input or output and axis"""
    file = io.BytesIO()
    torch.onnx.export(
        module.eval(), tuple(inputs.values()), file, input_names=list(inputs),
        output_names=outputs, dynamic_axes=free, opset_version=OPSET, dynamo=False,
        do_constant_folding=True, custom_opsets={"mvtop": 1},
    )  # fmt: skip
    graph = onnx.load_from_string(file.getvalue())
    graph.producer_name, graph.doc_string = "mvtop", ""
    return graph


def graphs_of(model: Mvtop) -> dict[str, onnx.ModelProto]:
    """Every graph of the network, by name."""
    config = model.config
    found = ["det_scores", "det_boxes"]

    def of_pictures(module, height, width, shapes, outputs, axis="views", any_size=False):
        inputs = {"images": torch.zeros(2, 3, height, width)}
        if shapes:
            cells = sum(rows * columns for rows, columns in shapes)
            inputs["camera_rays"] = torch.zeros(2, cells, 3)
        free = {name: {0: axis} for name in [*inputs, *outputs]}
        if any_size:
            free["images"] |= {2: "height", 3: "width"}
        return graph_of(module(model), inputs, outputs, free)

    size, shapes = (config.height, config.width), config.decoder_shapes()
    side = config.closeup
    if config.gives_coordinates:
        return {
            # Large images are shown larger (`mvtop-core/src/estimator/view.rs`).
            "features": of_pictures(ExportedDetector, *size, (), found, any_size=True),
            "closeup": of_pictures(
                ExportedCoordinates, side, side, (), ["coordinates"], "pictures"
            ),
        }
    return {
        "features": of_pictures(ExportedDetector, *size, (), found),
        "decoder": _decoder_of(model),
        "closeup": of_pictures(ExportedCloseUps, side, side, shapes, ["memory"], "pictures"),
    }


def outputs_of(config) -> list[str]:
    """Of the decoder, in their order."""
    one = ["rotation_6d", "translation", "sigma"]
    several = [f"hypotheses_{name}" for name in Hypotheses._fields]
    return one + several if config.hypotheses > 1 else one


def _decoder_of(model: Mvtop) -> onnx.ModelProto:
    config = model.config
    n = sum(rows * columns for rows, columns in config.decoder_shapes())
    of_boxes = {
        "centers": torch.rand(2, 2, 2),
        "half_sizes": torch.rand(2, 2, 2) * 0.2,
        "box_rays": torch.randn(2, 2, 12),
        "valid": torch.ones(2, 2),
    }
    inputs = {
        "memory": torch.randn(2, n, config.d_model),
        "rays": torch.randn(2, n, config.los_channels),
        **of_boxes,
        "class_index": torch.zeros(2, dtype=torch.long),
    }
    outputs = outputs_of(config)
    free = {name: {0: "views"} for name in ("memory", "rays")}
    free |= {name: {0: "views", 1: "objects"} for name in of_boxes}
    free |= {name: {0: "objects"} for name in ("class_index", *outputs)}
    return simplified(graph_of(ExportedDecoder(model), inputs, outputs, free))


def simplified(graph: onnx.ModelProto) -> onnx.ModelProto:
    """A graph that computes the same with fewer nodes, which loads faster."""
    from onnxscript import optimizer

    most = LARGE - 1  # Numbers that are made of constants; larger ones are weights.
    return optimizer.optimize(graph, input_size_limit=most, output_size_limit=most)


def store_in_half(graph: onnx.ModelProto):
    """Keep the large weights of a graph in half precision: half the file, computed in full."""

    def restored(name, values):
        half = onnx.numpy_helper.from_array(values.astype(np.float16), f"{name}.half")
        cast = onnx.helper.make_node("Cast", [half.name], [name], to=onnx.TensorProto.FLOAT)
        return [half], [cast]

    _store(graph, {tensor.name for tensor in graph.graph.initializer}, restored)


def store_in_bytes(graph: onnx.ModelProto):
    """Keep the weights of convolutions and linear layers in 8 bits, with a scale for each channel
    of the output: a quarter of the file, computed in full.

    Not as DequantizeLinear, which ONNX Runtime keeps for its kernels in 8 bits and computes anew
    each time: of a cast and a product it makes constants when it loads the graph.
    """

    def restored(name, values):
        codes, scale = in_bytes(values)
        made = [
            onnx.numpy_helper.from_array(codes, f"{name}.codes"),
            onnx.numpy_helper.from_array(scale, f"{name}.scale"),
        ]
        steps = f"{name}.steps"
        cast = onnx.helper.make_node("Cast", [made[0].name], [steps], to=onnx.TensorProto.FLOAT)
        return made, [cast, onnx.helper.make_node("Mul", [steps, made[1].name], [name])]

    layers = [node for node in graph.graph.node if node.op_type in ("Conv", "MatMul")]
    _store(graph, {node.input[1] for node in layers}, restored)


def in_bytes(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights [O, I, h, w] or [I, O] as whole numbers of a scale for each channel of the output."""
    axes = (1, 2, 3) if values.ndim == 4 else 0
    scale = np.abs(values).max(axes, keepdims=True).clip(1e-12) / 127
    return np.rint(values / scale).astype(np.int8), scale.astype(np.float32)


def as_stored(model: Mvtop) -> Mvtop:
    """A copy with the weights that `store_in_bytes` leaves of it."""
    model = copy.deepcopy(model)
    for module in model.modules():
        if isinstance(module, nn.Conv2d | nn.Linear) and module.weight.numel() >= LARGE:
            linear = isinstance(module, nn.Linear)  # [O, I]; graphs have [I, O]
            weight = module.weight.detach().numpy()
            codes, scale = in_bytes(weight.T if linear else weight)
            weight = codes * scale
            module.weight.data = torch.from_numpy(weight.T if linear else weight)
    return model


def _store(graph: onnx.ModelProto, names: set[str], restored):
    """Replace large weights of these names by other tensors and the nodes that make them again."""
    kept, first = [], []
    for tensor in graph.graph.initializer:
        values = onnx.numpy_helper.to_array(tensor)
        if values.dtype == np.float32 and values.size >= LARGE and tensor.name in names:
            tensors, nodes = restored(tensor.name, values)
            kept += tensors
            first += nodes
        else:
            kept.append(tensor)
    kept, nodes = [copy.deepcopy(tensor) for tensor in kept], [*first, *graph.graph.node]
    del graph.graph.initializer[:]
    graph.graph.initializer.extend(kept)
    del graph.graph.node[:]
    graph.graph.node.extend(nodes)
    onnx.checker.check_model(graph)


def fold_batch_norm(model: Mvtop) -> Mvtop:
    """A copy in which each batch normalisation is part of the convolution before it."""
    model = copy.deepcopy(model).eval()
    for _, module, i in list(normalised_convolutions(model)):
        module[i] = nn.utils.fuse_conv_bn_eval(module[i], module[i + 1])
        module[i + 1] = nn.Identity()
    return model


def normalised_convolutions(model: Mvtop):
    """(name, sequence, index) of each convolution that batch normalisation follows, in a sequence
    of this name."""
    for name, module in model.named_modules():
        if isinstance(module, nn.Sequential):
            for i in range(len(module) - 1):
                if isinstance(module[i], nn.Conv2d) and isinstance(module[i + 1], nn.BatchNorm2d):
                    yield name, module, i


def check_objects(who: str, names: list[str], known: tuple[objects.Object, ...]):
    """UserError where a network that knows `names` is not one of these objects.

    who  "weights know", or what else does
    """
    wanted = [obj.name for obj in known]
    if names != wanted:
        raise UserError(
            f"{who} {names}, expected {wanted}; "
            "fix: --data must name the data set that they were trained on"
        )


def _entry(path: Path) -> dict:
    content = path.read_bytes()
    return {"sha256": hashlib.sha256(content).hexdigest(), "bytes": len(content)}


def _symmetries(known: ObjectClass) -> dict:
    """As Rust reads them, metres; nothing of parts without."""
    discrete = [np.reshape(turn, (4, 4)).tolist() for turn in known.discrete]
    continuous = [{"axis": turn[:3], "offset": turn[3:]} for turn in known.continuous]
    found = {"symmetries_discrete": discrete, "symmetries_continuous": continuous}
    return {name: values for name, values in found.items() if values}


def check_closeups(config):
    """UserError for a network of whole images, which the engine does not run."""
    if not config.closeup:
        raise UserError(
            f"export: expected a network with close-ups, got preset {config.preset!r} without, "
            "which is for research alone (docs/decisions/0004-crops-instead-of-whole-images.md); "
            "fix: preset lite or small"
        )


def write_bundle(
    model: Mvtop, out: Path, provenance: dict, portable: bool = False,
    score_threshold: float = 0.3, known: tuple[objects.Object, ...] = (),
    agree_threshold: float | None = None, bits: int = 32,
    pictures: dict[str, np.ndarray] | None = None,
):  # fmt: skip
    """Write every file of a bundle; `model.json` comes last. `known`: the MV-ball if left out.

    bits      in which large weights are stored: 32, 16, or 8 (those of layers; others 16)
    pictures  of `integers.pictures_of`: convolutions are computed in 8 bits
    """
    config = model.config
    check_closeups(config)
    known = known or (objects.ball(),)
    check_objects("weights know", [c.name for c in config.classes], known)
    out.mkdir(parents=True, exist_ok=True)
    model = fold_batch_norm(model)
    with sampling.standard_operators() if portable else contextlib.nullcontext():
        graphs = graphs_of(model)
    tested = self_test.OfModel(as_stored(model) if bits < 16 else model)
    if pictures:
        with sampling.standard_operators():
            tested = self_test.OfGraphs(integers.of_all(graphs_of(model), pictures), config)
        graphs = integers.of_all(graphs, pictures)
    for name, graph in graphs.items():
        if bits < 16:
            store_in_bytes(graph)
        if bits < 32:
            store_in_half(graph)
        onnx.save(graph, out / f"{name}.onnx")
    for obj in known:
        rows = np.concatenate([obj.points.round(6), obj.colors.astype(int)], 1).tolist()
        rows = [[*row[:3], *(int(c) for c in row[3:])] for row in rows]
        (out / f"{obj.name}.points.json").write_text(json.dumps({"unit": "m", "points": rows}))
    files = [*(f"{name}.onnx" for name in graphs), *(f"{obj.name}.points.json" for obj in known)]
    agree = {} if agree_threshold is None else {"agree_threshold": agree_threshold}
    closeup = {"size": config.closeup, "strides": list(config.closeup_strides)}
    extents = [{"coordinates_extent_m": obj.extent_m} for obj in known]
    extents = extents if config.gives_coordinates else [{} for _ in known]
    about = {
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
            {"id": c.id, "name": c.name, "diameter_m": c.diameter_m,
             "points": f"{c.name}.points.json", **extent, **_symmetries(c)}
            for c, extent in zip(config.classes, extents, strict=True)
        ],
        "detector": {"score_threshold": score_threshold, **agree, "nms_iou": 0.5},
        "closeup": closeup,
        "graphs": {name: f"{name}.onnx" for name in graphs},
        "portable": portable,
        "files": {name: _entry(out / name) for name in files},
        "self_test": self_test.of(tested),
        "provenance": provenance,
    }  # fmt: skip
    description.write(out, about)

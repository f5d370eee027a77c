"""Convolutions computed in 8 bits: a half to a third of the time on ordinary processors.

What a convolution takes and gives becomes whole numbers of a scale, which is measured on pictures;
its weights those of a scale for each channel. The last convolution before each output, and what
follows, stays in floating point: boxes and coordinates are not in steps.
"""

import tempfile
from pathlib import Path

import numpy as np
import onnx
import torch
from onnxruntime import quantization
from onnxruntime.quantization.shape_inference import quant_pre_process

from ..data import batches
from ..data.closeup import CloseUps
from ..data.inputs import normalised
from ..data.objects import Object
from ..data.search import Searches
from ..data.views import ViewMaker
from ..network.config import Config

PICTURES = "images"  # the input that all of this depends on
# What has kernels for whole numbers, so that nothing between convolutions is in floating point.
KINDS = ("Add", "Clip", "Conv", "MaxPool", "Pad", "Relu", "Resize")
COUNT = 64  # pictures that ranges are measured on, of each kind


def pictures_of(config: Config, known: tuple[Object, ...], data: Path) -> dict[str, np.ndarray]:
    """By graph, what it may be shown: pictures of the training split, varied as in training."""
    scenes = batches.Scenes(data, known, 0)
    rng = np.random.default_rng(0)

    def drawn(made: list[dict], *names: str):
        arrays = (torch.from_numpy(np.stack([one[name] for one in made])) for name in names)
        return normalised(*arrays, config).numpy()

    searches = Searches(config, known)
    images = [scenes.images[n] for n in rng.integers(len(scenes.images), size=COUNT)]
    whole = [searches.make(image, rng) for image in images]
    maker = ViewMaker(CloseUps(config.closeup), config, known)
    things = [scenes.training[n] for n in rng.integers(len(scenes.training), size=COUNT)]
    views = [maker.make_view(images[rng.integers(len(images))], rng) for images in things]
    return {
        "features": drawn(whole, "search_image", "search_on_image"),
        "closeup": drawn(views, "image", "on_image"),
    }


def of_all(
    graphs: dict[str, onnx.ModelProto], pictures: dict[str, np.ndarray]
) -> dict[str, onnx.ModelProto]:
    """All graphs, those that are shown pictures with their convolutions in 8 bits."""
    return {
        name: in_integers(graph, pictures[name]) if name in pictures else graph
        for name, graph in graphs.items()
    }


def in_integers(graph: onnx.ModelProto, pictures: np.ndarray) -> onnx.ModelProto:
    """The graph with its convolutions in 8 bits; all of them work on its pictures alone.

    pictures  [n, 3, H, W] as the network takes them, of all kinds that it is to be shown
    """
    out = _without_constants(graph)
    before = _before_convolutions(out)
    first = [node for node in out.graph.node if node.name in before or node.op_type == "Conv"]
    rest = [node for node in out.graph.node if node not in first]
    made = {name for node in first for name in node.output}
    taken = {name for node in rest for name in node.input} | {x.name for x in out.graph.output}
    done = _quantized(_part(out, sorted(made & taken)), pictures)
    kept = [x for x in out.graph.initializer if x.name in taken]
    # Shapes of what mvtop's operator gives, without which OpenVINO refuses a graph.
    known = {name for node in rest for name in node.output}
    shapes = [x for x in out.graph.value_info if x.name in known]
    for field in (out.graph.node, out.graph.initializer, out.graph.value_info):
        del field[:]
    out.graph.node.extend([*done.graph.node, *rest])
    out.graph.initializer.extend([*done.graph.initializer, *kept])
    out.graph.value_info.extend(shapes)
    return out


def _without_constants(graph: onnx.ModelProto) -> onnx.ModelProto:
    """A copy in which these are initializers, which every part of a graph may take."""
    out = onnx.ModelProto()
    out.CopyFrom(graph)
    nodes = list(out.graph.node)
    del out.graph.node[:]
    for node in nodes:
        if node.op_type == "Constant":
            values = onnx.numpy_helper.to_array(node.attribute[0].t)
            constant = onnx.numpy_helper.from_array(values, node.output[0])
            out.graph.initializer.append(constant)
        else:
            out.graph.node.append(node)
    return out


def _part(graph: onnx.ModelProto, border: list[str]) -> onnx.ModelProto:
    """What computes these values of the pictures."""
    typed = onnx.ModelProto()
    typed.CopyFrom(graph)
    typed.graph.value_info.extend(
        onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, None) for name in border
    )
    part = onnx.utils.Extractor(typed).extract_model([PICTURES], border)
    # Equal tensors are one in a graph, and may be of the rest as well.
    others = ("nodes", "edges", "inputs", "outputs", "value_infos")
    return onnx.compose.add_prefix(part, "first.", **{f"rename_{x}": False for x in others})


def _quantized(graph: onnx.ModelProto, pictures: np.ndarray) -> onnx.ModelProto:
    with tempfile.TemporaryDirectory() as folder:
        given, whole, done = (Path(folder) / f"{name}.onnx" for name in ("given", "whole", "done"))
        onnx.save(graph, given)
        quant_pre_process(str(given), str(whole), skip_symbolic_shape=True)
        quantization.quantize_static(
            str(whole), str(done), _Pictures(pictures),
            quant_format=quantization.QuantFormat.QDQ,
            op_types_to_quantize=list(KINDS),
            nodes_to_quantize=sorted(_before_convolutions(onnx.load(whole))),
            per_channel=True,
            # Sums of two products fit in 16 bits, in which processors without VNNI add.
            reduce_range=True,
            activation_type=quantization.QuantType.QUInt8,
            weight_type=quantization.QuantType.QInt8,
            calibrate_method=quantization.CalibrationMethod.MinMax,
        )  # fmt: skip
        return onnx.load(done)


def _before_convolutions(graph: onnx.ModelProto) -> set[str]:
    """Names of the nodes whose result a convolution takes, by whatever way."""
    wanted, names = set(), set()
    for node in reversed(graph.graph.node):
        if wanted & set(node.output):
            names.add(node.name)
        elif node.op_type != "Conv":
            continue
        wanted |= set(node.input)
    return names


class _Pictures(quantization.CalibrationDataReader):
    def __init__(self, pictures: np.ndarray):
        self.left = iter(pictures)

    def get_next(self):
        picture = next(self.left, None)
        return None if picture is None else {PICTURES: picture[None]}

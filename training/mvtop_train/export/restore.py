"""Weights of a run from a bundle, to train on from what is shipped: `init` of a run's config.

    mvtop-train restore --bundle models/ycbv4 --data data/ycbv4 \\
        --out runs/ycbv4-shipped/weights.pt

They are as good as the bundle stores them. What it does not store is put in anew: normalisation
that was folded into convolutions has the statistics of the pretrained network, or of pictures of
--data; pose heads of earlier decoder layers, which only training has, are copies of the last with
output weights of zero, so that they do not pull on what is learnt before they know anything; layers
for object coordinates of networks that decode poses, which only training has, are random.
"""

import dataclasses
import re
from pathlib import Path

import numpy as np
import onnx
import torch
from onnx.reference import ReferenceEvaluator
from torch import nn

from .. import description
from ..data import objects
from ..errors import UserError, argument_parser, command
from ..network import config as configs
from ..network.encoder import DeformableAttention
from ..network.lite import load_pretrained
from ..network.model import Mvtop
from ..training.checkpoint import save_weights
from . import integers, self_test
from .bundle import check_objects, normalised_convolutions

RESTORING = ("Cast", "Mul", "DequantizeLinear")  # make weights of what is stored in fewer bits
# Of a normalisation, by which convolutions are divided: unused channels have next to none.
LEAST_SCALE = 1e-2
ROUNDING = 0.2  # of what a network answers to pictures, by its spread, that 8 bits may change
COMPARED = 16  # pictures of each kind


def of_bundle(
    bundle: Path, known: tuple[objects.Object, ...], data: Path, others: bool = False
) -> tuple[Mvtop, int]:
    """The network of a bundle, in eval mode, checked against what the bundle answers, and the steps
    that it was trained for.

    data    data set of `known`; normalisation is measured on its training split
    others  whether the bundle is of whatever objects, to learn `known` from: not checked, as to
            pictures of other objects 8 bits may answer something else
    """
    about = description.read(bundle)
    if others:
        classes = tuple(
            configs.ObjectClass(c["id"], c["name"], c["diameter_m"]) for c in about["classes"]
        )
    else:
        check_objects(f"{bundle} knows", [c["name"] for c in about["classes"]], known)
        classes = objects.classes_of(*known)
    graphs = {name: onnx.load(bundle / file) for name, file in about["graphs"].items()}
    given = {}
    for graph in graphs.values():
        given |= weights_of(graph)
    try:
        model = fresh(about["preset"], classes, given)
        put(given, model)
    except (KeyError, RuntimeError) as error:
        raise _other_than_expected(
            bundle, f"weights of preset {about['preset']!r}", error
        ) from None
    pictures = integers.pictures_of(model.config, known, data)
    pictures = {name: torch.from_numpy(x) for name, x in pictures.items()}
    measure_normalisation(model, pictures)
    model.eval()
    if not others and model.config.gives_coordinates:
        _compare(model, graphs, pictures, bundle)
    elif not others:
        _check(model, about["self_test"], bundle)
    return model, about["provenance"]["trained_steps"]


def weights_of(graph: onnx.ModelProto) -> dict[str, torch.Tensor]:
    """Weights of an exported graph by their names in `Mvtop`, in full precision; those of
    convolutions with the normalisation that is folded in."""
    constants = _constants(graph)
    found = {_plain(name): values for name, values in constants.items()}
    for node in graph.graph.node:
        own = [name for name in node.input if name in constants and name.startswith("onnx::")]
        if own and node.op_type == "MatMul":
            found[f"{_module_of(node.name)}.weight"] = constants[own[0]].T
        elif own and node.op_type == "Add":
            found[f"{_module_of(node.name)}.bias"] = constants[own[0]]
    return {name: torch.from_numpy(np.array(values)) for name, values in found.items()}


def _constants(graph: onnx.ModelProto) -> dict[str, np.ndarray]:
    """Initializers, and what is made of these alone."""
    found = {x.name: onnx.numpy_helper.to_array(x) for x in graph.graph.initializer}
    for node in graph.graph.node:
        given = [name for name in node.input if name]
        if node.op_type in RESTORING and all(name in found for name in given):
            inputs = {name: found[name] for name in given}
            found[node.output[0]] = ReferenceEvaluator(node).run(None, inputs)[0]
    return found


def _plain(name: str) -> str:
    """The name that a tensor had before `integers`."""
    return re.sub(r"^first\.|_DequantizeLinear_Output$", "", name)


def _module_of(node: str) -> str:
    """Of a linear layer: "/encoder/layers.0/ffn/ffn.2/Add" is features.encoder.layers.0.ffn.2"""
    path = node.strip("/").split("/")[:-1]
    inner = [a for a, b in zip(path, [*path[1:], ""], strict=True) if not b.startswith(f"{a}.")]
    return ".".join(["features", *inner] if inner[0] == "encoder" else inner)


def fresh(preset: str, classes: tuple[configs.ObjectClass, ...], given: dict) -> Mvtop:
    """A network of the shape of these weights that was not trained on the objects."""
    config = configs.preset(preset, classes)
    if config.gives_coordinates:
        model = Mvtop(config)
        load_pretrained(model.features)
        return model
    head = given[f"decoder.heads.{config.decoder_layers - 1}.rotation.4.bias"]
    return Mvtop(dataclasses.replace(config, hypotheses=len(head) // (6 * len(classes))))


@torch.no_grad()
def put(given: dict[str, torch.Tensor], model: Mvtop):
    """Put a bundle's weights into a network; what is never trained (`lite.Trunk`) stays.

    KeyError or RuntimeError if they are of another network
    """
    absent = ("features.trunk.",)
    if not model.config.gives_coordinates:
        absent += ("features.coordinates.",)
    trained = [name for name, _ in model.named_parameters() if not name.startswith(absent)]
    before = _as_trained(given, model, absent)
    model.load_state_dict({name: before[name] for name in trained}, strict=False)
    for heads in model.decoder.heads[:-1] if model.decoder else ():
        for mlp in heads.children():
            mlp[-1].weight.zero_()


def _as_trained(
    given: dict[str, torch.Tensor], model: Mvtop, absent: tuple[str, ...]
) -> dict[str, torch.Tensor]:
    """A bundle's weights as they were before the export.

    absent  beginnings of the names of what it does not store
    """
    config, given = model.config, dict(given)
    last = config.decoder_layers - 1
    for name in [name for name in given if name.startswith(f"decoder.heads.{last}.")]:
        for layer in range(last):
            given[name.replace(f".{last}.", f".{layer}.", 1)] = given[name]
    for name, module in model.named_modules():
        if isinstance(module, DeformableAttention):
            cells = module.cells(config.decoder_shapes())
            given[f"{name}.offsets.weight"] = given[f"{name}.weight"] / cells[:, None]
            given[f"{name}.offsets.bias"] = given[f"{name}.bias"] / cells
    for name, module, i in normalised_convolutions(model):
        if not f"{name}.".startswith(absent):
            _unfold(f"{name}.{i}", f"{name}.{i + 1}", module[i + 1], given)
    return given


def _unfold(conv: str, norm: str, module: nn.BatchNorm2d, given: dict[str, torch.Tensor]):
    """Weights of a convolution and of its normalisation, which keeps statistics and scale, from
    those of what they became together."""
    small = module.weight.abs() < LEAST_SCALE
    scale = torch.where(small, LEAST_SCALE, module.weight)
    step = scale / (module.running_var + module.eps).sqrt()
    bias = given.pop(f"{conv}.bias") + module.running_mean * step
    weight = given[f"{conv}.weight"] / step[:, None, None, None]
    given |= {f"{conv}.weight": weight, f"{norm}.weight": scale, f"{norm}.bias": bias}


@torch.no_grad()
def measure_normalisation(model: Mvtop, pictures: dict[str, torch.Tensor]):
    """Let normalisation that training measures anew begin with the statistics of pictures.

    What the network answers in eval mode does not change.

    pictures  of `integers.pictures_of`
    """
    model.train()
    measured = [x for x in model.modules() if isinstance(x, nn.BatchNorm2d) and x.training]
    model.eval()
    seen = {x: [] for x in measured}
    hooks = [x.register_forward_hook(lambda m, i, _: seen[m].append(i[0])) for x in measured]
    features = model.features
    describe = features.describe if model.config.gives_coordinates else features.pose_levels
    features.detect(pictures["features"])
    describe(pictures["closeup"])
    for hook in hooks:
        hook.remove()
    for module, maps in seen.items():
        mean = torch.stack([x.mean((0, 2, 3)) for x in maps]).mean(0)
        variance = torch.stack([x.var((0, 2, 3)) for x in maps]).mean(0)
        step = module.weight / (module.running_var + module.eps).sqrt()
        module.bias += (mean - module.running_mean) * step
        module.weight.copy_(step * (variance + module.eps).sqrt())
        module.running_mean.copy_(mean)
        module.running_var.copy_(variance)


@torch.no_grad()
def _compare(model: Mvtop, graphs: dict[str, onnx.ModelProto], pictures: dict, bundle: Path):
    """Against what the bundle's graphs answer to pictures of its objects: of noise, as the
    self-test has it, 8 bits make something else."""
    stored, own = self_test.OfGraphs(graphs, model.config), self_test.OfModel(model)
    shown = {name: x[:COMPARED] for name, x in pictures.items()}
    for name, answer in (
        ("boxes", lambda network: network.detect(shown["features"])[1]),
        ("coordinates", lambda network: network.coordinates(shown["closeup"])),
    ):
        expected, got = answer(stored), answer(own)
        off = float((got - expected).abs().mean() / expected.std())
        if off > ROUNDING:
            raise _other_than_expected(
                bundle, f"{name} within {ROUNDING} of their spread", f"{off:.2f}"
            )


def _check(model: Mvtop, told: dict, bundle: Path):
    """Against what the bundle says that it answers to a fixed input."""
    answers = self_test.outputs(self_test.OfModel(model))
    del answers["det_scores"]  # of noise: all but zero, which steps of 8 bits are as well
    for name, values in answers.items():
        expected = np.array(told["outputs"][name])
        off = np.abs(np.array(values) - expected).max() / np.abs(expected).max()
        if off > told["tolerance"]:
            raise _other_than_expected(bundle, f"{name} {expected.tolist()}", values)


def _other_than_expected(bundle: Path, expected: str, got) -> UserError:
    return UserError(
        f"{bundle}: expected {expected}, got {str(got).splitlines()[-1].strip()}; "
        "fix: a bundle that this version of mvtop_train wrote"
    )


@command
def main():
    parser = argument_parser(__doc__)
    parser.add_argument("--bundle", type=Path, required=True, help="folder with a model.json")
    parser.add_argument("--data", type=Path, required=True, help="data set that it was trained on")
    parser.add_argument(
        "--start", action="store_true",
        help="of whatever objects, for a network that is to learn those of --data",
    )  # fmt: skip
    parser.add_argument("--out", type=Path, required=True, help="weights.pt to write")
    args = parser.parse_args()
    if args.out.exists():
        raise UserError(f"{args.out}: expected no such file, got one; fix: another --out")
    model, steps = of_bundle(args.bundle, objects.read_all(args.data), args.data, args.start)
    if args.start:
        steps = 0  # of what it is to learn
    args.out.parent.mkdir(parents=True, exist_ok=True)
    save_weights(model, steps, steps, args.out)
    print(f"{args.out}: {model.config.preset}, {steps} steps")


if __name__ == "__main__":
    main()

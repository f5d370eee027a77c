"""Convolutions in 8 bits: how far their answers are from those in floating point."""

import json

import numpy as np
import onnx
import onnxruntime
import torch
from test_export import run

from mvtop_train.export import bundle, self_test


def test_in_integers_graphs_answer_nearly_the_same(closeups, tmp_path):
    config = closeups.config
    sides = {"features": (config.height, config.width), "closeup": (config.closeup,) * 2}
    drawn = np.random.default_rng(0)
    pictures = {
        name: drawn.uniform(-2, 2, (4, 3, *side)).astype(np.float32) for name, side in sides.items()
    }
    exact, whole = tmp_path / "exact", tmp_path / "whole"
    bundle.write_bundle(closeups, exact, {}, portable=True)
    bundle.write_bundle(closeups, whole, {}, portable=True, pictures=pictures)
    cells = sum(rows * columns for rows, columns in config.decoder_shapes())
    for name in sides:
        inputs = {"images": torch.from_numpy(pictures[name][:2])}
        if name == "closeup":
            inputs["camera_rays"] = torch.randn(2, cells, 3)
        ours, theirs = (
            run(onnxruntime.InferenceSession(folder / f"{name}.onnx"), inputs)
            for folder in (whole, exact)
        )
        for a, b in zip(ours, theirs, strict=True):
            assert 0 < np.abs(a - b).mean() < 0.1 * b.std(), name
        graph = onnx.load(whole / f"{name}.onnx").graph
        weights = {x.name: x.data_type for x in graph.initializer}
        given = {out: node.op_type for node in graph.node for out in node.output}
        convolutions = [node for node in graph.node if node.op_type == "Conv"]
        in_floats = [node for node in convolutions if given[node.input[0]] != "DequantizeLinear"]
        assert len(in_floats) < 0.3 * len(convolutions)
        assert onnx.TensorProto.INT8 in weights.values()


def test_what_a_network_in_integers_answers_is_of_its_graphs(closeups, tmp_path):
    config = closeups.config
    pictures = {
        "features": self_test.numbers(2, 3, config.height, config.width).numpy(),
        "closeup": self_test.numbers(2, 3, config.closeup, config.closeup).numpy(),
    }
    bundle.write_bundle(closeups, tmp_path, {}, portable=True, pictures=pictures)
    told = json.loads((tmp_path / "model.json").read_text())["self_test"]["outputs"]
    graphs = {name: onnx.load(tmp_path / f"{name}.onnx") for name in (*pictures, "decoder")}
    answer = self_test.outputs(self_test.OfGraphs(graphs, config))
    for name, values in answer.items():
        np.testing.assert_allclose(values, told[name], rtol=1e-4, atol=1e-6, err_msg=name)
    in_floats = self_test.outputs(self_test.OfModel(closeups))
    assert told["det_boxes"] != in_floats["det_boxes"]
    # The decoder has no convolutions, and what it is asked about does not hang on any.
    for name in ("rotation_6d", "translation", "sigma"):
        np.testing.assert_allclose(told[name], in_floats[name], rtol=1e-3, atol=1e-4, err_msg=name)


def test_what_our_operator_gives_has_a_known_rank(closeups, tmp_path):
    """Else OpenVINO refuses the graph: it does not ask the operator."""
    side = closeups.config.closeup
    pictures = {
        "features": self_test.numbers(2, 3, closeups.config.height, closeups.config.width).numpy(),
        "closeup": self_test.numbers(2, 3, side, side).numpy(),
    }
    bundle.write_bundle(closeups, tmp_path, {}, pictures=pictures)
    for name in ("closeup", "decoder"):
        graph = onnx.load(tmp_path / f"{name}.onnx").graph
        ranks = {x.name: len(x.type.tensor_type.shape.dim) for x in graph.value_info}
        given = [out for node in graph.node if node.domain == "mvtop" for out in node.output]
        assert given
        assert {ranks.get(out) for out in given} == {3}, name

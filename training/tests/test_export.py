"""Exported graphs in ONNX Runtime give what PyTorch gives, for any number of views."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from conftest import WHOLE, drawn

from mvtop_train.data import objects
from mvtop_train.errors import UserError
from mvtop_train.export import __main__ as command
from mvtop_train.export import bundle, self_test
from mvtop_train.training.checkpoint import TrainingState


def run(session, inputs):
    names = {i.name for i in session.get_inputs()}
    return session.run(None, {n: x.numpy() for n, x in inputs.items() if n in names})


def closeup_inputs(c, views):
    n = sum(rows * columns for rows, columns in c.decoder_shapes())
    return {
        "images": torch.randn(views, 3, c.closeup, c.closeup),
        "camera_rays": torch.nn.functional.normalize(torch.randn(views, n, 3), dim=-1),
    }


def decoder_inputs(c, views, queries):
    n = sum(rows * columns for rows, columns in c.decoder_shapes())
    valid = torch.ones(views, queries)
    if views > 2:
        valid[2, 0] = 0
    return {
        "memory": torch.randn(views, n, c.d_model),
        "rays": torch.randn(views, n, c.los_channels),
        "centers": torch.rand(views, queries, 2),
        "half_sizes": torch.rand(views, queries, 2) * 0.2,
        "box_rays": torch.randn(views, queries, 12),
        "valid": valid,
        "class_index": torch.zeros(queries, dtype=torch.long),
    }


@pytest.fixture(scope="module")
def tiny():
    """The tiny network, of close-ups."""
    return drawn()


@pytest.fixture(scope="module")
def portable(tiny, tmp_path_factory):
    out = tmp_path_factory.mktemp("portable")
    bundle.write_bundle(tiny, out, {}, portable=True)
    return out


def test_self_test_is_in_the_manifest_and_what_the_graphs_answer(tiny, portable):
    # Multiples of 0.618..., less whole numbers, times two less one.
    first = self_test.numbers(3).tolist()
    assert first == pytest.approx([-1.0, 0.236068, -0.527864], abs=1e-6)
    expected = json.loads((portable / "model.json").read_text())["self_test"]
    c = tiny.config
    session = onnxruntime.InferenceSession
    images = {"images": self_test.numbers(1, 3, c.height, c.width)}
    scores, boxes = run(session(portable / "features.onnx"), images)
    inputs = {
        "images": self_test.numbers(1, 3, c.closeup, c.closeup),
        "camera_rays": self_test.rays(sum(h * w for h, w in c.decoder_shapes())),
    }
    (memory,) = run(session(portable / "closeup.onnx"), inputs)
    got = {
        "det_scores": [scores.mean(), scores.max()],
        "det_boxes": boxes.mean((0, 2, 3)),
        "memory": [memory.mean(), np.abs(memory).mean()],
    }
    for name, numbers in got.items():
        np.testing.assert_allclose(numbers, expected["outputs"][name], rtol=1e-3, atol=1e-5)
    assert [len(expected["outputs"][x]) for x in ("rotation_6d", "translation", "sigma")] == [
        6,
        3,
        2,
    ]
    assert 0 < expected["tolerance"] <= 0.05


@pytest.mark.parametrize("views, queries", [(1, 1), (2, 1), (3, 2), (4, 3)])
def test_portable_graphs_match_torch(tiny, portable, views, queries):
    torch.manual_seed(views)
    c = tiny.config
    for name, module, inputs in (
        (
            "features",
            bundle.ExportedDetector(tiny),
            {"images": torch.randn(views, 3, c.height, c.width)},
        ),
        ("closeup", bundle.ExportedCloseUps(tiny), closeup_inputs(c, views)),
        ("decoder", bundle.ExportedDecoder(tiny), decoder_inputs(c, views, queries)),
    ):
        session = onnxruntime.InferenceSession(portable / f"{name}.onnx")
        with torch.no_grad():
            expected = module(**inputs)
            expected = (expected,) if torch.is_tensor(expected) else expected
        for ours, theirs in zip(run(session, inputs), expected, strict=True):
            np.testing.assert_allclose(ours, theirs.numpy(), atol=2e-4, rtol=1e-3)


def test_the_bundle_has_no_grid_sample_and_states_operator_shapes(tiny, tmp_path):
    bundle.write_bundle(tiny, tmp_path, {})
    count = 0
    for name in ("features", "closeup", "decoder"):
        graph = onnx.load(tmp_path / f"{name}.onnx").graph
        assert "GridSample" not in {node.op_type for node in graph.node}
        known = {info.name: info.type.tensor_type.shape.dim for info in graph.value_info}
        for node in graph.node:
            if node.op_type == "DeformableSampling":
                count += 1
                assert node.domain == "mvtop"
                assert len(known[node.output[0]]) == 3
                assert known[node.output[0]][2].dim_value == tiny.config.d_model
    # One per encoder layer, one at the box centers, one per decoder layer.
    assert count == tiny.config.encoder_layers + 1 + tiny.config.decoder_layers


def test_model_json_lists_every_file_with_its_checksum(tiny, tmp_path):
    bundle.write_bundle(tiny, tmp_path, {"note": "test"})
    description = json.loads((tmp_path / "model.json").read_text())
    files = {p.name for p in tmp_path.iterdir()} - {"model.json"}
    assert set(description["files"]) == files
    for name, entry in description["files"].items():
        assert entry == bundle._entry(tmp_path / name)
    assert description["detector"] == {"score_threshold": 0.3, "nms_iou": 0.5}
    bundle.write_bundle(tiny, tmp_path, {}, agree_threshold=0.2)
    detector = json.loads((tmp_path / "model.json").read_text())["detector"]
    assert detector == {"score_threshold": 0.3, "agree_threshold": 0.2, "nms_iou": 0.5}


def test_without_git_a_bundle_is_of_no_commit(monkeypatch):
    monkeypatch.setenv("PATH", "")
    assert command._commit() is None


def test_networks_of_whole_images_have_no_bundle(tmp_path):
    with pytest.raises(UserError, match="expected a network with close-ups, got preset 'tiny'"):
        bundle.write_bundle(drawn(**WHOLE), tmp_path, {})
    assert not list(tmp_path.iterdir())


def test_networks_of_whole_images_are_refused_before_pictures_are_taken(tmp_path, monkeypatch):
    data, run = tmp_path / "data", tmp_path / "run"
    objects.write(data, [(objects.ball(), objects.ball_mesh())])
    TrainingState(run, drawn(**WHOLE).config, "cpu").save()
    arguments = ["--weights", run / "weights.pt", "--data", data, "--out", tmp_path / "bundle"]
    monkeypatch.setattr("sys.argv", ["export", *map(str, arguments), "--integers"])
    with pytest.raises(SystemExit, match="expected a network with close-ups"):
        command.main()


def test_onnx_runtime_keeps_nothing_of_its_user(tmp_path):
    """It is imported by the training itself, not through mvtop, which sees to it."""
    graph = Path(__file__).parents[2] / "fixtures/deformable_sampling_portable.onnx"
    script = f"import mvtop_train, onnxruntime; onnxruntime.InferenceSession({str(graph)!r})"
    kept = ("ORT_DISABLE_TELEMETRY", "XDG_CACHE_HOME")
    variables = {name: value for name, value in os.environ.items() if name not in kept}
    subprocess.run(
        [sys.executable, "-c", script], env=variables | {"HOME": str(tmp_path)}, check=True
    )
    assert not list(tmp_path.iterdir())

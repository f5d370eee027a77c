"""What a stranger's graphs take at most: memory where they are loaded and first run, and time."""

import hashlib
import json
import shutil
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
onnx = pytest.importorskip("onnx")


def bundle(folder, change):
    """A copy of a bundle with another first graph, whose checksum is right."""
    shutil.copytree(ROOT / "fixtures/tiny", folder)
    path = folder / "features.onnx"
    model = onnx.load(path)
    change(model.graph)
    onnx.save(model, path)
    manifest = json.loads((folder / "model.json").read_text())
    bytes_ = path.read_bytes()
    manifest["files"]["features.onnx"] = {
        "sha256": hashlib.sha256(bytes_).hexdigest(),
        "bytes": len(bytes_),
    }
    manifest.pop("self_test", None)
    (folder / "model.json").write_text(json.dumps(manifest))
    return folder


def add_to_scores(graph, number):
    """Adds what a node gives to the detector's scores."""
    for node in graph.node:
        for i, name in enumerate(node.output):
            if name == "det_scores":
                node.output[i] = "scores_before"
    graph.node.append(onnx.helper.make_node("Add", ["scores_before", number], ["det_scores"]))


def greedy(at_load):
    """Asks for 10 GB, of a constant or of the number of images."""

    def change(graph):
        numbers = onnx.helper.make_tensor("many", onnx.TensorProto.INT64, [1], [25 * 10**8])
        graph.initializer.append(numbers)
        make = onnx.helper.make_node
        shape = "many"
        if not at_load:
            zero = onnx.helper.make_tensor("first", onnx.TensorProto.INT64, [1], [0])
            graph.initializer.append(zero)
            graph.node.append(make("Shape", ["images"], ["sides"]))
            graph.node.append(make("Gather", ["sides", "first"], ["count"], axis=0))
            graph.node.append(make("Mul", ["count", "many"], ["shape"]))
            shape = "shape"
        graph.node.append(make("ConstantOfShape", [shape], ["huge"]))
        graph.node.append(make("ReduceMax", ["huge"], ["most"], keepdims=0))
        add_to_scores(graph, "most")

    return change


@pytest.mark.parametrize("at_load", [True, False])
def test_a_graph_that_asks_for_more_memory_than_any_network_is_refused(
    at_load, tmp_path, in_new_process
):
    folder = bundle(tmp_path / "greedy", greedy(at_load))
    script = """
import resource, sys, mvtop
sample = "fixtures/tiny/sample"
rig = mvtop.Rig.load(f"{sample}/rig.json")
images = [f"{sample}/{camera.id}.png" for camera in rig.cameras]
before = resource.getrlimit(resource.RLIMIT_DATA)
try:
    mvtop.Estimator.load(sys.argv[1]).predict(images, rig)
    raise SystemExit("was not refused")
except mvtop.Error as error:
    assert "features.onnx" in str(error) and "\\n" not in str(error), error
assert resource.getrlimit(resource.RLIMIT_DATA) == before
assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < 5 << 20  # KiB
# What is not greedy works on in the same process.
assert len(mvtop.Estimator.load("fixtures/tiny").predict(images, rig)) > 0
"""
    in_new_process(script, str(folder), timeout=120)

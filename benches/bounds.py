"""What the processor would allow: the network's multiply-adds, and reading images.

    python benches/bounds.py
    python benches/bounds.py --model models/parts --json FILE

Times a bundle's graphs in ONNX Runtime on all cores. The bounds are large matrix products of 8-bit
integers, and copying memory.
"""

import os
import statistics
import time
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import result_file
from mvtop_train.errors import argument_parser, command
from onnx import TensorProto, helper, shape_inference

ROOT = Path(__file__).resolve().parents[1]
SIDE = 2048  # of the matrices whose product is the bound
COPIED = 1 << 28  # bytes
IMAGE = 4000 * 3000 * 3  # bytes of 12 megapixels


def seconds(run, rounds: int) -> float:
    """Of one run, median; the first run warms up."""
    times = []
    for _ in range(rounds + 1):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return statistics.median(times[1:])


def session(model: onnx.ModelProto) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = os.cpu_count() or 1
    providers = ["CPUExecutionProvider"]
    return onnxruntime.InferenceSession(model.SerializeToString(), options, providers)


def multiply_adds(model: onnx.ModelProto) -> int:
    """Of its convolutions, for inputs of fixed shape."""
    graph = shape_inference.infer_shapes(model, data_prop=True).graph
    shapes = {
        value.name: [side.dim_value for side in value.type.tensor_type.shape.dim]
        for value in [*graph.value_info, *graph.output]
    }
    shapes |= {one.name: list(one.dims) for one in graph.initializer}
    return sum(
        int(np.prod(shapes[node.output[0]])) * int(np.prod(shapes[node.input[1]][1:]))
        for node in graph.node
        if node.op_type == "Conv"
    )


def fixed(path: Path, batch: int, sides: tuple[int, int] | None) -> onnx.ModelProto:
    """A graph for a number of pictures, of another size where it takes any."""
    model = onnx.load(path)
    shape = model.graph.input[0].type.tensor_type.shape.dim
    shape[0].dim_value = batch
    for axis, side in zip(shape[2:], sides or (), strict=bool(sides)):
        axis.dim_value = side
    return model


def integers_per_second(rounds: int) -> float:
    """Multiply-adds of 8-bit integers in large matrix products."""
    shape = [SIDE, SIDE]
    node = helper.make_node("MatMulInteger", ["a", "b"], ["c"])
    a = helper.make_tensor_value_info("a", TensorProto.UINT8, shape)
    b = np.random.default_rng(0).integers(-64, 64, shape, np.int8)
    weights = onnx.numpy_helper.from_array(b, "b")
    c = helper.make_tensor_value_info("c", TensorProto.INT32, shape)
    graph = helper.make_graph([node], "product", [a], [c], [weights])
    opset = [helper.make_opsetid("", 17)]
    product = session(helper.make_model(graph, opset_imports=opset, ir_version=8))
    given = {"a": np.full(shape, 100, np.uint8)}
    return SIDE**3 / seconds(lambda: product.run(None, given), rounds)


@command
def main():
    parser = argument_parser(__doc__)
    parser.add_argument("--model", type=Path, default=ROOT / "models/ycbv4")
    parser.add_argument("--batch", type=int, default=8, help="pictures at once")
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--json", type=Path, help="a section of docs/benchmarks.md")
    args = parser.parse_args()
    peak = integers_per_second(args.rounds)
    source, target = np.ones(COPIED, np.uint8), np.empty(COPIED, np.uint8)
    copied = 2 * COPIED / seconds(lambda: np.copyto(target, source), args.rounds)
    rows = []
    for name, title, sides in (
        ("features", "detector, an image of 512x384", (384, 512)),
        ("closeup", "coordinates, a crop", None),
    ):
        model = fixed(args.model / f"{name}.onnx", args.batch, sides)
        shape = [axis.dim_value for axis in model.graph.input[0].type.tensor_type.shape.dim]
        pictures = np.random.default_rng(0).normal(size=shape).astype(np.float32)
        graph, inputs = session(model), {model.graph.input[0].name: pictures}
        took = seconds(lambda g=graph, i=inputs: g.run(None, i), args.rounds) / args.batch
        count = multiply_adds(model) / args.batch
        rows.append(
            [title, f"{count / 1e9:.2f} G", f"{1e3 * took:.1f}", f"{100 * count / peak / took:.0f}"]
        )
    read = IMAGE / copied
    title = "an image of 12 megapixels, read at memory's speed"
    rows.append([title, f"{IMAGE / 1e6:.0f} MB", f"{1e3 * read:.1f}", ""])
    columns = ["", "multiply-adds, bytes", "ms", "% of the peak"]
    notes = [
        f"Peaks: {peak / 1e9:.0f} G multiply-adds of 8-bit integers a second in matrix products of "
        f"{SIDE} rows, {copied / 1e9:.0f} GB a second of memory, read and written."
    ]
    for row in [columns, *rows]:
        print(" | ".join(row))
    print(*notes)
    if args.json:
        result_file.write(args.json, "What the processor would allow", 0, columns, rows, notes)


if __name__ == "__main__":
    main()

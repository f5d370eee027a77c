"""Write two graphs that sample alike: one with mvtop's operator, one with standard operators.

    python -m mvtop_train.fixtures_operator [FOLDER]     (default: fixtures)

The Rust tests and benchmarks run both on the same inputs. Both take

    value      [B, N, H, D]
    locations  [B, Q, H, L, K, 2]     (x, y) from 0 to 1 over the level
    weights    [B, Q, H, L, K]

and give `out` [B, Q, H*D]; Q is free.
"""

import sys
from pathlib import Path

import onnx
from onnx import TensorProto, helper

LEVELS = [(20, 20), (10, 10), (5, 5)]
BATCH, HEADS, DIM, POINTS = 2, 8, 16, 4


class Graph:
    """Nodes and constants in the order they are added; methods return the name of the result."""

    def __init__(self):
        self.nodes, self.constants = [], []

    def node(self, kind, inputs, output=None, **attributes):
        output = output or f"{kind}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, inputs, [output], name=output, **attributes))
        return output

    def constant(self, value, kind=TensorProto.INT64):
        name = f"constant_{len(self.constants)}"
        shape, flat = ([len(value)], value) if isinstance(value, list) else ([], [value])
        self.constants.append(helper.make_tensor(name, kind, shape, flat))
        return name

    def reshape(self, tensor, shape, output=None):
        return self.node("Reshape", [tensor, self.constant(shape)], output)

    def transpose(self, tensor, *axes):
        return self.node("Transpose", [tensor], perm=axes)

    def model(self):
        def tensor(name, *shape):
            return helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)

        cells, levels = sum(h * w for h, w in LEVELS), len(LEVELS)
        graph = helper.make_graph(
            self.nodes,
            "deformable_sampling",
            [
                tensor("value", BATCH, cells, HEADS, DIM),
                tensor("locations", BATCH, "Q", HEADS, levels, POINTS, 2),
                tensor("weights", BATCH, "Q", HEADS, levels, POINTS),
            ],
            [tensor("out", BATCH, "Q", HEADS * DIM)],
            initializer=self.constants,
        )
        opsets = [helper.make_opsetid("", 18), helper.make_opsetid("mvtop", 1)]
        model = helper.make_model(graph, opset_imports=opsets, ir_version=9)
        onnx.checker.check_model(model)
        return model


def with_operator():
    graph = Graph()
    graph.node(
        "DeformableSampling",
        ["value", "locations", "weights"],
        "out",
        domain="mvtop",
        level_shapes=[side for level in LEVELS for side in level],
    )
    return graph.model()


def with_standard_operators():
    """GridSample of each level, the heads moved into the batch."""
    graph, sums, first = Graph(), [], 0
    # GridSample has -1 to 1 over the map where the operator has 0 to 1.
    doubled = graph.node("Mul", ["locations", graph.constant(2.0, TensorProto.FLOAT)])
    grids = graph.node("Sub", [doubled, graph.constant(1.0, TensorProto.FLOAT)])
    for level, (height, width) in enumerate(LEVELS):
        rows = [graph.constant([first]), graph.constant([first + height * width])]
        first += height * width
        maps = graph.node("Slice", ["value", *rows, graph.constant([1])])
        maps = graph.transpose(maps, 0, 2, 3, 1)
        maps = graph.reshape(maps, [BATCH * HEADS, DIM, height, width])
        grid = graph.node("Gather", [grids, graph.constant(level)], axis=3)  # [B, Q, H, K, 2]
        grid = graph.transpose(grid, 0, 2, 1, 3, 4)
        grid = graph.reshape(grid, [BATCH * HEADS, -1, POINTS, 2])
        read = graph.node(
            "GridSample", [maps, grid], mode="bilinear", padding_mode="zeros", align_corners=0
        )  # [B*H, D, Q, K]
        weight = graph.node("Gather", ["weights", graph.constant(level)], axis=3)  # [B, Q, H, K]
        weight = graph.transpose(weight, 0, 2, 1, 3)
        weight = graph.reshape(weight, [BATCH * HEADS, 1, -1, POINTS])
        weighted = graph.node("Mul", [read, weight])
        sums.append(graph.node("ReduceSum", [weighted, graph.constant([3])], keepdims=0))
    total = graph.reshape(graph.node("Sum", sums), [BATCH, HEADS * DIM, -1])
    graph.node("Transpose", [total], "out", perm=[0, 2, 1])
    return graph.model()


def main():
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "fixtures")
    onnx.save(with_operator(), folder / "deformable_sampling.onnx")
    onnx.save(with_standard_operators(), folder / "deformable_sampling_portable.onnx")


if __name__ == "__main__":
    main()

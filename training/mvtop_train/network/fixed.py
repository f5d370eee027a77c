"""What is never trained, computed by ONNX Runtime: on processors several times sooner than by
PyTorch."""

import io
import warnings

import onnxruntime
import torch
from torch import nn


class Fixed:
    """A part of a network with the weights that it has now: images [B, 3, H, W] -> map, float32."""

    def __init__(self, part: nn.Module):
        file, free = io.BytesIO(), {0: "batch", 2: "height", 3: "width"}
        with warnings.catch_warnings(action="ignore"):  # of what need not be folded
            torch.onnx.export(
                part, torch.zeros(1, 3, 64, 64), file, input_names=["images"], output_names=["map"],
                dynamic_axes={"images": free, "map": free}, opset_version=17, dynamo=False,
            )  # fmt: skip
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = torch.get_num_threads()
        # Else its threads would keep the cores from PyTorch's while they wait.
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        cpu = ["CPUExecutionProvider"]
        self._session = onnxruntime.InferenceSession(file.getvalue(), options, providers=cpu)

    def __call__(self, images: torch.Tensor) -> torch.Tensor:
        given = {"images": images.detach().float().contiguous().numpy()}
        return torch.from_numpy(self._session.run(None, given)[0])

    def __deepcopy__(self, memo):
        return self  # it never changes

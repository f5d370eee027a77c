"""One contestant of `peers.py` in a process of its own, so that its memory is its own as well.

    python benches/peers_worker.py CONTESTANT WORK

Reads numbers of views from stdin; for each runs the network once and prints, as a line of JSON, the
milliseconds that it took, the process's peak memory so far, and the poses it got. Nothing is
imported but what the contestant needs.
"""

import contextlib
import json
import os
import sys
import time
from pathlib import Path

import numpy as np

LIBRARY = "MVTOP_PEERS_LIBRARY"  # ONNX Runtime with OpenVINO, which must not be beside the other
ANCHORS = 4  # mvtop decodes an object in each of the four views that show it largest


class Inputs:
    """What the graphs are given, by their inputs' names, contiguous."""

    def __init__(self, work: Path):
        with np.load(work / "inputs.npz") as file:
            self.all = dict(file)

    def _first(self, views: int, *names: str) -> dict:
        return {name.split(".")[-1]: np.ascontiguousarray(self.all[name][:views]) for name in names}

    def features(self, views: int) -> dict:
        return self._first(views, "images")

    def closeup(self, views: int) -> dict:
        found = self._first(views, "pictures", "camera_rays")
        return {"images": found["pictures"], "camera_rays": found["camera_rays"]}

    def anchors(self, views: int) -> list[int]:
        """Of so many views those in which mvtop decodes the object."""
        largest = np.argsort(-self.all["sizes"][:views], kind="stable")
        return sorted(largest[:ANCHORS].tolist())

    def decoder(self, views: int, anchor: int) -> tuple[list[int], dict]:
        """The views' order, the anchor first, and the inputs without the memory."""
        order = [anchor, *(view for view in range(views) if view != anchor)]
        names = ("rays", "centers", "half_sizes", "box_rays")
        given = {name: self.all[f"{anchor}.{name}"][order] for name in names}
        given["valid"] = np.ones((views, 1), np.float32)
        given["class_index"] = np.zeros(1, np.int64)
        return order, given


class Graphs:
    """Runs the network's graphs; a subclass says how one is loaded and run."""

    def __init__(self, work: Path):
        self.inputs = Inputs(work)
        names = ("features", "closeup", "decoder")
        self.graphs = {name: self.load(work / "portable" / f"{name}.onnx") for name in names}

    def prepare(self, views: int):
        inputs = self.inputs
        anchors = [inputs.decoder(views, anchor) for anchor in inputs.anchors(views)]
        return inputs.features(views), inputs.closeup(views), anchors

    def __call__(self, prepared) -> list:
        features, closeup, anchors = prepared
        self.run(self.graphs["features"], features)
        memory = self.run(self.graphs["closeup"], closeup)["memory"]
        return [
            (order[0], self.run(self.graphs["decoder"], {"memory": memory[order], **given}))
            for order, given in anchors
        ]

    def poses(self, decoded: list) -> dict:
        """The decoder's answers, by anchor and name."""
        return {
            anchor: {name: np.asarray(x, float).tolist() for name, x in one.items()}
            for anchor, one in decoded
        }


class OnnxRuntime(Graphs):
    def load(self, path: Path):
        import onnxruntime

        session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
        return (
            session,
            [one.name for one in session.get_inputs()],
            [one.name for one in session.get_outputs()],
        )

    def run(self, graph, inputs: dict) -> dict:
        session, known, outputs = graph
        values = session.run(outputs, {name: inputs[name] for name in known})
        return dict(zip(outputs, values, strict=True))


class OpenVino(Graphs):
    """Compiled for the shapes that it is given, once for each number of views."""

    precision = "f32"

    def load(self, path: Path):
        return path, {}

    def run(self, graph, inputs: dict) -> dict:
        path, compiled = graph
        views = next(iter(inputs.values())).shape[0]
        if views not in compiled:
            import openvino

            core = openvino.Core()
            model = core.read_model(path)
            known = [port.get_any_name() for port in model.inputs]
            model.reshape({name: list(inputs[name].shape) for name in known})
            model = self.changed(model, path.stem, {name: inputs[name] for name in known})
            options = {"INFERENCE_PRECISION_HINT": self.precision, "PERFORMANCE_HINT": "LATENCY"}
            model = core.compile_model(model, "CPU", options)
            compiled[views] = model.create_infer_request(), known
        request, known = compiled[views]
        outputs = request.infer({name: inputs[name] for name in known}, share_inputs=True)
        return {port.get_any_name(): value for port, value in outputs.items()}

    def changed(self, model, name: str, inputs: dict):
        """The graph `name` as it is compiled."""
        return model


class OpenVinoBf16(OpenVino):
    precision = "bf16"


class OpenVinoIntegers(OpenVino):
    """Convolutions in 8 bits, ranges from what graphs are given; decoders would be off by cm."""

    def changed(self, model, name: str, inputs: dict):
        if name == "decoder":
            return model
        with contextlib.redirect_stdout(sys.stderr):  # stdout has the answers alone
            import nncf

            return nncf.quantize(model, nncf.Dataset([inputs]), subset_size=1)


class OpenVinoBf16Integers(OpenVinoIntegers):
    precision = "bf16"


class Torch(Graphs):
    """The modules that are exported, in standard operators."""

    autocast = False

    def __init__(self, work: Path):
        import torch
        from mvtop_train.export import bundle
        from mvtop_train.network import sampling

        self.torch, self.sampling = torch, sampling
        self.inputs = Inputs(work)
        model = torch.load(work / "model.pt", weights_only=False)
        modules = {
            "features": bundle.ExportedDetector(model),
            "closeup": bundle.ExportedCloseUps(model),
            "decoder": bundle.ExportedDecoder(model),
        }
        self.graphs = {name: self.load(module.eval()) for name, module in modules.items()}
        self.answers = bundle.outputs_of(model.config)

    def load(self, module):
        return module

    def prepare(self, views: int):
        def tensors(arrays):
            return {name: self.torch.from_numpy(array) for name, array in arrays.items()}

        features, closeup, anchors = super().prepare(views)
        anchors = [(order, tensors(given)) for order, given in anchors]
        return tensors(features), tensors(closeup), anchors

    def run(self, graph, inputs: dict) -> dict:
        outputs = graph(**inputs)
        outputs = outputs if isinstance(outputs, tuple) else (outputs,)
        names = self.answers if "rays" in inputs else ("memory",)
        return dict(zip(names, outputs, strict=False))

    def __call__(self, prepared) -> list:
        torch = self.torch
        with (
            torch.inference_mode(),
            self.sampling.standard_operators(),
            torch.autocast("cpu", torch.bfloat16, enabled=self.autocast),
        ):
            return super().__call__(prepared)

    def poses(self, decoded: list) -> dict:
        return super().poses(
            [(at, {name: x.float().numpy() for name, x in one.items()}) for at, one in decoded]
        )


class TorchCompiled(Torch):
    def load(self, module):
        return self.torch.compile(module)


class TorchBf16(Torch):
    autocast = True


class Mvtop:
    """All of it, from arrays of the whole images to the pose, boxes given."""

    bundle = "bundle"
    options: dict = {}

    def __init__(self, work: Path):
        import mvtop

        self.mvtop = mvtop
        self.estimator = mvtop.Estimator.load(work / self.bundle, **self.options)
        self.rig = mvtop.Rig.load(work / "rig.json")
        self.boxes = json.loads((work / "boxes.json").read_text())
        with np.load(work / "images.npz") as file:
            self.images = dict(file)

    def prepare(self, views: int):
        cameras = self.rig.cameras[:views]
        ids = [camera.id for camera in cameras]
        boxes = [{"class": self.boxes["class"], "boxes": {i: self.boxes["boxes"][i] for i in ids}}]
        return {i: self.images[i] for i in ids}, self.mvtop.Rig(cameras), boxes

    def __call__(self, prepared):
        images, rig, boxes = prepared
        return self.estimator.predict(images, rig, boxes=boxes, refine=False)

    def poses(self, prediction) -> list:
        return prediction.objects[0].world_from_obj.tolist()


class MvtopIntegers(Mvtop):
    """As bundles are shipped: convolutions in 8 bits."""

    bundle = "integers"


class MvtopOpenVino(MvtopIntegers):
    """The same on OpenVINO through ONNX Runtime, of the library that `peers.py` was given."""

    options = {"provider": "openvino-bf16", "ort_lib": os.environ.get(LIBRARY)}


CONTESTANTS = {
    "mvtop": Mvtop,
    "mvtop int8": MvtopIntegers,
    "mvtop OpenVINO int8": MvtopOpenVino,
    "ONNX Runtime, portable": OnnxRuntime,
    "OpenVINO f32": OpenVino,
    "OpenVINO bf16": OpenVinoBf16,
    "OpenVINO int8": OpenVinoIntegers,
    "OpenVINO bf16 int8": OpenVinoBf16Integers,
    "PyTorch fp32": Torch,
    "PyTorch fp32 compiled": TorchCompiled,
    "PyTorch bf16": TorchBf16,
}


def peak_mb() -> float:
    """Of this process's memory, MB; `ru_maxrss` is at least that of the process it came from."""
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) / 1e3


def main():
    name, work = sys.argv[1:]
    contestant, prepared = CONTESTANTS[name](Path(work)), {}
    for line in sys.stdin:
        views = int(line)
        if views not in prepared:
            prepared[views] = contestant.prepare(views)
        begun = time.perf_counter()
        answer = contestant(prepared[views])
        taken = time.perf_counter() - begun
        said = {"ms": 1e3 * taken, "peak_mb": peak_mb(), "poses": contestant.poses(answer)}
        print(json.dumps(said), flush=True)


if __name__ == "__main__":
    main()

"""Export a trained network as a bundle: `model.json` beside two ONNX graphs.

    python -m mvtop_train.export --weights runs/small-cpu/weights.pt --out models/mvball

`features.onnx` runs once on all views, `decoder.onnx` once per reference camera; between them
Rust finds the boxes and computes the lines of sight. Networks with close-ups have a third,
`closeup.onnx`, which runs once on these, and the first then only detects. The deformable sampling
is the custom operator `mvtop::DeformableSampling`; `--portable` writes standard operators instead.
"""

import datetime
import subprocess
from pathlib import Path

import torch

from ..data import objects
from ..errors import argument_parser, command
from ..network import config as configs
from ..network.model import Mvtop
from ..training.checkpoint import load_weights
from .bundle import write_bundle


def _commit() -> str | None:
    command = ["git", "rev-parse", "--short", "HEAD"]
    result = subprocess.run(command, capture_output=True, text=True, cwd=Path(__file__).parent)
    return result.stdout.strip() or None


@command
def main():
    parser = argument_parser(__doc__)
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--weights", type=Path, help="last.pt of a run")
    source.add_argument("--untrained", choices=configs.PRESETS, help="random weights of a preset")
    parser.add_argument("--out", type=Path, required=True, help="bundle folder")
    parser.add_argument("--data", type=Path, help="data set of the object, if not MV-ball")
    parser.add_argument("--object", type=int, metavar="ID", help="of the objects in --data")
    parser.add_argument(
        "--half", action="store_true", help="weights in half precision: half the size"
    )
    parser.add_argument("--portable", action="store_true", help="standard operators only")
    parser.add_argument(
        "--score-threshold", type=float, default=0.3, help="least score of an object"
    )
    parser.add_argument(
        "--agree-threshold", type=float, help="least score of a box that another view agrees with"
    )
    args = parser.parse_args()
    obj = objects.read(args.data, args.object) if args.data else None
    if args.weights:
        model, config, step = load_weights(args.weights)
    else:
        torch.manual_seed(0)
        classes = objects.classes_of(obj or objects.ball())
        config, step = configs.preset(args.untrained, classes), 0
        model = Mvtop(config).eval()
    provenance = {
        "trained_steps": step,
        "torch": torch.__version__,
        "commit": _commit(),
        "date": datetime.date.today().isoformat(),
    }
    write_bundle(
        model, args.out, provenance, args.portable, args.score_threshold, obj,
        args.agree_threshold, args.half,
    )  # fmt: skip
    size = sum(f.stat().st_size for f in args.out.iterdir()) / 1e6
    print(f"{args.out}: {config.preset}, {step} steps, {size:.1f} MB")


if __name__ == "__main__":
    main()

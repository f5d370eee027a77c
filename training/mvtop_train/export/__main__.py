"""Export a trained network as a bundle: `model.json` beside its ONNX graphs (`bundle.py`).

    mvtop-train export --weights runs/small-cpu/weights.pt --out models/mvball

The deformable sampling is the custom operator `mvtop::DeformableSampling`; `--portable` writes
standard operators instead.
"""

import datetime
import subprocess
from pathlib import Path

import torch

from ..data import objects
from ..errors import UserError, argument_parser, command, printable
from ..network import config as configs
from ..network.model import Mvtop
from ..training.checkpoint import load_weights
from . import integers, mesh
from .bundle import check_closeups, write_bundle


def _commit() -> str | None:
    command = ["git", "rev-parse", "--short", "HEAD"]
    try:
        result = subprocess.run(command, capture_output=True, text=True, cwd=Path(__file__).parent)
    except OSError:  # no git
        return None
    return result.stdout.strip() or None


@command
def main():
    parser = argument_parser(__doc__)
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--weights", type=Path, help="last.pt of a run")
    source.add_argument("--untrained", choices=configs.PRESETS, help="random weights of a preset")
    parser.add_argument("--out", type=Path, required=True, help="bundle folder")
    parser.add_argument("--data", type=Path, help="data set of the objects, if not MV-ball")
    parser.add_argument(
        "--object", type=int, metavar="ID", help="one of the objects in --data, alone"
    )
    parser.add_argument(
        "--bits", type=int, choices=(32, 16, 8), default=32,
        help="of stored weights; computed is in full: 16 halves the files, 8 (of layers) "
        "makes a quarter of them",
    )  # fmt: skip
    parser.add_argument(
        "--integers", action="store_true",
        help="compute convolutions in 8 bits, within ranges measured on the training split of "
        "--data: less than half of the time",
    )  # fmt: skip
    parser.add_argument("--portable", action="store_true", help="standard operators only")
    parser.add_argument(
        "--score-threshold", type=float, default=0.3, help="least score of an object"
    )
    parser.add_argument(
        "--agree-threshold", type=float, help="least score of a box that another view agrees with"
    )
    args = parser.parse_args()
    ids = (args.object,) if args.object else ()
    known = objects.read_all(args.data, ids) if args.data else (objects.ball(),)
    if args.weights:
        model, config, step = load_weights(args.weights)
    else:
        torch.manual_seed(0)
        classes = objects.classes_of(*known)
        config, step = configs.preset(args.untrained, classes), 0
        model = Mvtop(config).eval()
    check_closeups(config)  # before pictures are taken
    provenance = {
        "trained_steps": step,
        "torch": torch.__version__,
        "commit": _commit(),
        "date": datetime.date.today().isoformat(),
    }
    pictures = integers.pictures_of(config, known, args.data) if args.integers else None
    write_bundle(
        model, args.out, provenance, args.portable, args.score_threshold, known,
        args.agree_threshold, args.bits, pictures,
    )  # fmt: skip
    try:
        mesh.add(args.out, mesh.meshes_of(args.data, known))
    except UserError as error:  # the bundle is whole without them
        print(f"without meshes, on which poses are refined: {printable(error)}")
    size = sum(f.stat().st_size for f in args.out.iterdir()) / 1e6
    print(f"{args.out}: {config.preset}, {step} steps, {size:.1f} MB")


if __name__ == "__main__":
    main()

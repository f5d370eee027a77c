"""Methods and variants side by side: same frozen features, same data, same budget.

    python -m mvtop_train.study --weights runs/small-cpu/weights.pt --data data/mvball \
        --test data/test --out out/study

Trains the transformer and heads of each variant on cached features of canonical views
(`canonical.py`) and tests it on scenes that no training used. It resumes where it was stopped.
Minutes are of processor time; a process uses one core (`--threads`), so several may run at once,
each with variants of its own.
"""

import dataclasses
import json
from pathlib import Path

import torch

from ..data import bop, objects
from ..data.bank import Bank
from ..data.views import ViewMaker
from ..errors import argument_parser, command
from ..training.checkpoint import load_weights
from . import canonical, plots, variants
from .variants import VARIANTS


@command
def main():
    parser = argument_parser(__doc__)
    parser.add_argument("--weights", type=Path, required=True, help="whose backbone is frozen")
    parser.add_argument("--data", type=Path, required=True, help="training scenes")
    parser.add_argument("--test", type=Path, required=True, help="test scenes: splits hard, easy")
    parser.add_argument("--out", type=Path, required=True, help="results and cached features")
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=list(VARIANTS))
    parser.add_argument("--scenes", type=int, default=1500, help="training scenes to use")
    parser.add_argument("--copies", type=int, default=2, help="augmented copies of each image")
    parser.add_argument("--minutes", type=float, default=60.0, help="to train each variant")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--levels", type=int, nargs="+", default=[1, 2], help="pyramid levels")
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    budget = variants.Budget(minutes=args.minutes)
    model, trained, _ = load_weights(args.weights)
    strides = tuple(trained.strides[level] for level in args.levels)
    viewed = variants.config_of(VARIANTS["baseline"], trained, strides)

    def cached(root: Path, split: str, scenes: int | None, copies: int, augment: bool) -> Bank:
        index = bop.load_index(root, split)[:scenes]
        name = f"{split}-{len(index)}x{copies}-levels{''.join(map(str, args.levels))}"
        maker = ViewMaker(canonical.Canonical(), viewed, (objects.ball(),), augment)
        features = canonical.Maps(model.features.backbone, trained.strides, strides)
        return Bank(args.out / name, index, maker, features, copies, seed=0)

    for name in args.variants:
        variant = VARIANTS[name]
        folder = args.out / f"{name}-seed{args.seed}"
        path = folder.with_suffix(".json")
        if path.exists():
            continue
        control = variant.data == "control"
        train_split, tests = (
            ("control", ["control_test"]) if control else ("train", ["hard", "easy"])
        )
        data = cached(args.data, train_split, args.scenes, args.copies, True)
        config = variants.config_of(variant, trained, strides)
        seen = {split: cached(args.test, split, None, 1, False) for split in tests}

        def look(network, variant=variant, seen=seen):
            return {split: variants.test(network, variant, bank) for split, bank in seen.items()}

        state = variants.fit(variant, data, config, folder, args.weights, budget, args.seed, look)
        result = {
            "variant": dataclasses.asdict(variant) | {"name": name},
            "steps": state.step, "images_per_step": variants.IMAGES, "seed": args.seed,
            "scenes": len(data.scenes), "minutes": round(state.elapsed / 60, 2),
        }  # fmt: skip
        result |= look(state.average)
        path.write_text(json.dumps(result) + "\n")
    text = variants.table(args.out)
    (args.out / "study.md").write_text(text)
    plots.learning(args.out / "curves.png", variants.curves(args.out))
    print(text)


if __name__ == "__main__":
    main()

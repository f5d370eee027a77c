"""What the camera is worth that a prediction names as the next one: beside any other.

    python -m mvtop_train.study.next_view --samples out/five --model models/mvball

For each sample (`synthesis/samples.py`) that one camera leaves open, poses from that one and each
of the others: the one that is named, all of them, and the best by the truth.
"""

from pathlib import Path

import numpy as np
from tqdm import tqdm

from ..errors import argument_parser, command
from .samples import folders, nearest_to, true_pose


def rotation_error_deg(prediction, world_from_obj: np.ndarray) -> float:
    """Of the object that is nearest; 180 where nothing is found."""
    import mvtop

    found = nearest_to(prediction, world_from_obj)
    if found is None:
        return 180.0
    return float(mvtop.metrics.rotation_error_deg(world_from_obj, found.world_from_obj))


def errors_of(sample: Path, estimator) -> tuple[str, dict[str, float]] | None:
    """The camera that is named, and the error with each other one as the second, degrees; None
    where the first camera leaves nothing open."""
    import mvtop

    rig = mvtop.Rig.load(sample / "rig.json")
    first, *others = (camera.id for camera in rig.cameras)

    def seen_by(*ids: str):
        return estimator.predict({name: sample / f"{name}.png" for name in ids}, rig)

    alone = seen_by(first)
    if not alone.objects or alone.objects[0].next_view is None:
        return None
    known = true_pose(sample)
    errors = {other: rotation_error_deg(seen_by(first, other), known) for other in others}
    return alone.objects[0].next_view, errors


@command
def main():
    parser = argument_parser(__doc__)
    parser.add_argument("--samples", type=Path, required=True, help="folder of sample folders")
    parser.add_argument("--model", type=Path, required=True, help="folder of model.json")
    args = parser.parse_args()
    import mvtop

    samples = folders(args.samples)
    estimator = mvtop.Estimator.load(args.model)
    told = [errors_of(sample, estimator) for sample in tqdm(samples, unit="sample")]
    told = [one for one in told if one is not None]
    rows = {
        "named": [errors[name] for name, errors in told],
        "any": [error for _, errors in told for error in errors.values()],
        "best": [min(errors.values()) for _, errors in told],
    }
    print(f"{len(told)} of {len(samples)} samples are left open by the first camera")
    for name, errors in rows.items():
        x = np.array(errors)
        print(f"{name:6} mean {x.mean():5.2f}  median {np.median(x):5.2f}  "
              f"over 5: {(x > 5).mean():5.1%}  over 15: {(x > 15).mean():5.1%}")  # fmt: skip


if __name__ == "__main__":
    main()

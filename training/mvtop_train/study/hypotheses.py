"""How often one of an object's hypotheses is right, and how often the first, by number of views.

    python -m mvtop_train.study.hypotheses --samples out/eval/hard-seed1-views2-300 \
        --model models/mvball

Poses of the network alone, boxes detected, of the first view of each sample and of all of them.
Needs mvtop's wheel (`make wheel`).
"""

from pathlib import Path

import numpy as np
from tqdm import tqdm

from ..errors import argument_parser, command
from .samples import folders, nearest_to, true_pose


def errors_of(sample: Path, estimator, views: int) -> list[float]:
    """Rotation error of each hypothesis, degrees, the likeliest first; 180 if nothing is found."""
    import mvtop

    rig = mvtop.Rig.load(sample / "rig.json")
    known = true_pose(sample)
    images = {camera.id: sample / f"{camera.id}.png" for camera in rig.cameras[:views]}
    found = nearest_to(estimator.predict(images, rig, refine=False), known)
    if found is None:
        return [180.0]
    poses = np.stack([one.world_from_obj for one in found.hypotheses])
    return mvtop.metrics.rotation_error_deg(known, poses).tolist()


@command
def main():
    parser = argument_parser(__doc__)
    parser.add_argument("--samples", type=Path, required=True, help="folder of sample folders")
    parser.add_argument("--model", type=Path, required=True, help="folder of model.json")
    parser.add_argument("--within", type=float, default=15.0, help="what counts as right, degrees")
    args = parser.parse_args()
    import mvtop

    samples = folders(args.samples)
    estimator = mvtop.Estimator.load(args.model)
    most = len(mvtop.Rig.load(samples[0] / "rig.json").cameras)
    print(f"| views | samples | hypotheses | first within {args.within:g}° | one of them |")
    print("|---|---|---|---|---|")
    for views in sorted({1, most}):
        told = [errors_of(one, estimator, views) for one in tqdm(samples, unit="sample")]
        first = np.mean([errors[0] <= args.within for errors in told])
        one = np.mean([min(errors) <= args.within for errors in told])
        count = np.mean([len(errors) for errors in told])
        print(f"| {views} | {len(told)} | {count:.1f} | {first:.1%} | {one:.1%} |")


if __name__ == "__main__":
    main()

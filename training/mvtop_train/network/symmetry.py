"""Parts that look the same after a turn: which of the poses that look alike a prediction is near.

Only what no view can tell belongs here. Turns that one view leaves open and another settles, as on
MV-ball, are no symmetries: to accept the nearest of them would teach the wrong pose.
"""

from dataclasses import dataclass

import torch

from .config import ObjectClass


@dataclass
class Symmetries:
    """Of each class, padded to the same number; see `of`.

    discrete [C, S, 4, 4] with the identity first; axis, offset [C, 3], an axis of 0 where there is
    none; size [C], such that (size |dR|_F)^2 is about the mean square of how far points move.
    """

    discrete: torch.Tensor
    axis: torch.Tensor
    offset: torch.Tensor
    size: torch.Tensor

    def to(self, device) -> "Symmetries":
        return Symmetries(*(x.to(device) for x in vars(self).values()))


def of(classes: tuple[ObjectClass, ...]) -> Symmetries:
    """The symmetries of a network's classes; of several axes (a ball) the first counts."""
    most = 1 + max(len(c.discrete) for c in classes)
    discrete = torch.eye(4).repeat(len(classes), most, 1, 1)
    axis, offset = torch.zeros(len(classes), 3), torch.zeros(len(classes), 3)
    for n, known in enumerate(classes):
        for m, rows in enumerate(known.discrete):
            discrete[n, m + 1] = torch.tensor(rows).reshape(4, 4)
        if known.continuous:
            turn = torch.tensor(known.continuous[0])
            axis[n], offset[n] = torch.nn.functional.normalize(turn[:3], dim=0), turn[3:]
    return Symmetries(discrete, axis, offset, torch.tensor([c.diameter_m / 6 for c in classes]))


@torch.no_grad()
def nearest(rotation, translation, truth, class_index, known: Symmetries):
    """The symmetry [..., 4, 4] after which the truth is nearest to a prediction.

    One for rotation and translation together: an axis off the origin couples them. The true pose
    that counts is `truth @ nearest(...)`.

    rotation [..., 3, 3], translation [..., 3] (None: rotations alone count), truth [..., 4, 4],
    class_index [...]
    """
    turns = known.discrete[class_index]  # [..., S, 4, 4]
    axis, offset = known.axis[class_index][..., None, :], known.offset[class_index][..., None, :]
    posed = truth[..., None, :, :] @ turns
    # Turn by t about the axis a: a a^T + cos t (1 - a a^T) + sin t [a]; the best t in closed form.
    m = rotation[..., None, :, :].transpose(-1, -2) @ posed[..., :3, :3]
    along = (axis[..., None, :] @ m @ axis[..., None])[..., 0, 0]
    trace = m.diagonal(dim1=-2, dim2=-1).sum(-1)
    skew = torch.stack(
        [m[..., 1, 2] - m[..., 2, 1], m[..., 2, 0] - m[..., 0, 2], m[..., 0, 1] - m[..., 1, 0]], -1
    )
    angle = torch.atan2((skew * axis).sum(-1), trace - along)
    turns = turns @ _turn(axis.expand(*angle.shape, 3), offset.expand(*angle.shape, 3), angle)
    posed = truth[..., None, :, :] @ turns
    away = ((posed[..., :3, :3] - rotation[..., None, :, :]) ** 2).sum((-2, -1))
    cost = away * known.size[class_index][..., None] ** 2
    if translation is not None:
        cost = cost + ((posed[..., :3, 3] - translation[..., None, :]) ** 2).sum(-1)
    best = cost.argmin(-1)[..., None, None, None].expand(*cost.shape[:-1], 1, 4, 4)
    return turns.gather(-3, best).squeeze(-3)


def _turn(axis, offset, angle):
    """About `axis` [..., 3] through `offset` by `angle` [...]; the identity where the axis is 0."""
    zero = torch.zeros_like(angle)
    x, y, z = axis.unbind(-1)
    skew = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).unflatten(-1, (3, 3))
    sin, cos = angle.sin()[..., None, None], angle.cos()[..., None, None]
    pose = torch.zeros(*angle.shape, 4, 4, device=angle.device)
    pose[..., :3, :3] = torch.eye(3, device=angle.device) + sin * skew + (1 - cos) * (skew @ skew)
    moved = (pose[..., :3, :3] @ offset[..., None])[..., 0]
    pose[..., :3, 3], pose[..., 3, 3] = offset - moved, 1
    return pose

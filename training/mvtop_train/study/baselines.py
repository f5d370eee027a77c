"""Other ways to get a pose from several views, to compare with: each looks at one view at a time.

Ours, small, and faithful to what the papers describe; each is given the known cameras.
- Late fusion (CosyPose, Labbe et al. 2020): one candidate per view; candidates that agree are
  refined together by their reprojections.
- Voting (Li et al. 2018): the best K hypotheses of each view; the one that the others support most
  wins. `network/voting.py` makes them.
"""

import numpy as np
import torch
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from torch import nn

from ..network import pose

INLIER = 0.02  # m, mean distance of model points: CosyPose's
VOTE = 0.02  # m, sigma of Li et al.


def _moved(points, poses):
    """Model points [n, 3] under poses [..., 4, 4]: [..., n, 3]."""
    return points @ poses[..., :3, :3].swapaxes(-1, -2) + poses[..., None, :3, 3]


def _distances(points, poses):
    """Mean distances of the model points under every two of poses [m, 4, 4]: [m, m], metres."""
    import mvtop  # loads its compiled part

    surface = mvtop.metrics.Surface(points)
    return np.stack([surface.add(pose, poses) for pose in poses])


def late_fusion(candidates, ref_from_cam, k, points) -> tuple[np.ndarray, int]:
    """One pose from a candidate of each view.

    candidates    [V, 4, 4] cam_from_obj, metres
    ref_from_cam  [V, 4, 4] metres
    k             [V, 3, 3] px
    points        [n, 3] of the model, metres
    returns       ref_from_obj [4, 4], and how many views agree on it (1: it is the reference's own)
    """
    in_ref = ref_from_cam @ candidates
    distances = _distances(points, in_ref)
    agree = distances <= INLIER
    counts = agree.sum(1)
    seed = min(range(len(in_ref)), key=lambda i: (-counts[i], (distances[i] * agree[i]).sum()))
    if counts[seed] < 2:
        return in_ref[0], 1
    views = np.flatnonzero(agree[seed])
    cam_from_ref = np.linalg.inv(ref_from_cam[views])

    def project(in_cam):
        pixels = in_cam @ k[views].swapaxes(-1, -2)
        return pixels[..., :2] / pixels[..., 2:]

    wanted = project(_moved(points, candidates[views]))
    start = in_ref[seed]

    def pose_of(step):
        moved = start.copy()
        moved[:3, :3] = Rotation.from_rotvec(step[:3]).as_matrix() @ start[:3, :3]
        moved[:3, 3] += step[3:]
        return moved

    def residuals(step):
        return (project(_moved(points, cam_from_ref @ pose_of(step))) - wanted).ravel()

    # CosyPose caps each residual at 5 px; a soft cap keeps it differentiable.
    result = least_squares(residuals, np.zeros(6), loss="soft_l1", f_scale=5.0, x_scale="jac")
    return pose_of(result.x), len(views)


def vote(hypotheses, ref_from_cam, points) -> np.ndarray:
    """The hypothesis that those of the other views support most.

    hypotheses    [V, K, 4, 4] cam_from_obj, best first, metres
    ref_from_cam  [V, 4, 4] metres
    points        [n, 3] of the model, metres
    returns       ref_from_obj [4, 4]
    """
    views, count = hypotheses.shape[:2]
    in_ref = (ref_from_cam[:, None] @ hypotheses).reshape(-1, 4, 4)
    support = np.maximum(VOTE - _distances(points, in_ref), 0)
    view = np.repeat(np.arange(views), count)
    support = (support * (view[:, None] != view[None])).sum(1)
    # Without any support the reference view's best is first.
    return in_ref[int(support.argmax())]


def hypothesis_loss(outputs, cam_from_obj):
    """Cross entropy on the nearest bin, rotation error within it, translation error."""
    total = 0.0
    for logits, rotations, translation, bins in outputs:
        truth = cam_from_obj[..., :3, :3]
        trace = torch.einsum("nij,bqij->bqn", bins, truth)
        nearest = trace.argmax(-1)
        entropy = nn.functional.cross_entropy(logits.flatten(0, 1), nearest.flatten())
        index = nearest[..., None, None, None].expand(*nearest.shape, 1, 3, 3)
        picked = rotations.gather(2, index)[:, :, 0]
        angle = pose.rotation_angle(picked, truth).mean()
        distance = pose.translation_error(translation, cam_from_obj[..., :3, 3]).mean()
        total = total + entropy + angle + 10 * distance
    return total

"""Several hypotheses of each view with their scores, to vote among (Li et al. 2018): a baseline."""

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import nn

from . import pose
from .geometry import Geometry
from .layers import mlp
from .paper import ImageDecoder, ImageEncoder

BINS = 512  # of rotations, 22 degrees apart


def rotation_bins(count: int) -> np.ndarray:
    """Rotations [count, 3, 3] spread evenly (super-Fibonacci spiral, Alexa 2022)."""
    phi, psi = np.sqrt(2), 1.533751168755204288118041
    s = np.arange(count) + 0.5
    r, big_r = np.sqrt(s / count), np.sqrt(1 - s / count)
    alpha, beta = 2 * np.pi * s / phi, 2 * np.pi * s / psi
    quaternions = [r * np.sin(alpha), r * np.cos(alpha), big_r * np.sin(beta), big_r * np.cos(beta)]
    return Rotation.from_quat(np.stack(quaternions, 1)).as_matrix()


class HypothesisHeads(nn.Module):
    """Scores of rotation bins, a rotation within each, and one translation (Li et al. 2018)."""

    def __init__(self, config):
        super().__init__()
        d = config.d_model
        self.scores, self.translation = mlp(d, d, d, BINS), mlp(d, d, d, 3)
        self.within = mlp(d, d, d, 6 * BINS)
        bins = torch.from_numpy(rotation_bins(BINS)).float()
        self.register_buffer("bins", bins, persistent=False)

    def forward(self, x, class_index, boxes):
        """x [B, Q, C] -> logits [B, Q, n], rotations [B, Q, n, 3, 3], translation [B, Q, 3] m."""
        identity = torch.tensor([1.0, 0, 0, 0, 1, 0], device=x.device)
        within = 0.1 * self.within(x).unflatten(-1, (-1, 6)) + identity
        rotations = pose.rotation_from_6d(within) @ self.bins
        return self.scores(x), rotations, self.translation(x)


class HypothesisDecoder(ImageDecoder):
    parts = ImageDecoder.parts._replace(heads=HypothesisHeads)


IMAGE_HYPOTHESES = Geometry(ImageEncoder, HypothesisDecoder)

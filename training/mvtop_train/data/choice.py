"""Which images of a scene are looked at together."""

import numpy as np

from . import bop


def fixed_views(scene: list[bop.Image], count: int, most: int) -> list[list[bop.Image]]:
    """Up to `most` lists of up to `count` images for validation, the same in every run.

    Of MV-ball each starts with an image of either hemisphere, so that two determine the pose.
    """
    green = [image for image in scene if image.shows == "green"]
    red = [image for image in scene if image.shows == "red"]
    if not green and not red:
        return [(scene[n:] + scene[:n])[:count] for n in range(min(most, len(scene)))]
    return [
        [green[n], red[n], *green[n + 1 :], *red[n + 1 :]][:count]
        for n in range(min(most, len(green), len(red)))
    ]


def choose_views(scene: list[bop.Image], count: int, rng: np.random.Generator) -> list[bop.Image]:
    """`count` images in random order; of MV-ball mostly with both hemispheres among them."""
    order = rng.permutation(len(scene))
    first = scene[order[0]].shows
    if first and count >= 2 and rng.random() < 0.9:
        other = next((i for i in order if scene[i].shows != first), order[1])
        rest = [i for i in order[1:] if i != other]
        order = rng.permutation([order[0], other, *rest][:count])
    return [scene[i] for i in order[:count]]


def draw_views(scenes: list, shares: np.ndarray, rng) -> tuple[int, list[int]]:
    """How many views a batch's scenes have, and the numbers of the scenes with that many images.

    shares: of batches with 1, 2, ... views
    """
    # Scenes of other data sets differ in their number of images.
    most = max(len(scene) for scene in scenes)
    shares = shares * (np.arange(1, len(shares) + 1) <= most)
    views = 1 + int(rng.choice(len(shares), p=shares / shares.sum()))
    return views, [number for number, scene in enumerate(scenes) if len(scene) >= views]

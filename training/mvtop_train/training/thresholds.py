"""The scores from which a box is taken, chosen on scenes that training left out: by the pipeline,
and by `mvtop-train calibrate --weights`."""

from dataclasses import dataclass

import numpy as np
import torch
from torchvision.ops import box_iou
from tqdm import tqdm

from ..data.inputs import normalised
from ..data.search import Searches
from ..evaluation.matching import LEAST, assigned, peaks

# Weight of recall in the F score: later stages reject false boxes, but find no others.
BETA = 2.0
RECALL = 0.98  # of all that the best threshold finds, kept by boxes that another view agrees with


@dataclass
class Thresholds:
    """Scores for the bundle, and how good boxes are with the first of them."""

    score: float
    agree: float
    precision: float
    recall: float
    iou: float  # mean, of those that are right

    def settings(self) -> dict[str, float]:
        """As `detector` of a bundle has them."""
        return {"score_threshold": self.score, "agree_threshold": self.agree}

    def __str__(self):
        return (
            f"boxes at score {self.score:g} (agreed on, {self.agree:g}): precision "
            f"{self.precision:.3f}, recall {self.recall:.3f}, IoU {self.iou:.2f}"
        )


@torch.no_grad()
def boxes_of(model, images: torch.Tensor):
    """Per image: boxes [n, 4] px, scores [n], classes [n], as `mvtop-core` finds them."""
    scores, boxes = model.features.detect(images)
    return peaks(scores.float().sigmoid(), boxes)


def matched(boxes, scores, classes, truth, index):
    """[(score, IoU or 0)] of the boxes that count (`assigned`), best first."""
    iou = box_iou(boxes, truth) if len(truth) else torch.zeros(len(boxes), 0)
    return [
        (float(scores[n]), 0.0 if owner is None else float(iou[n, owner]))
        for n, owner in assigned(boxes, scores, classes, truth, index)
    ]


def choose(model, images, searches: Searches, batch: int = 8) -> Thresholds:
    """The threshold with the best F score (`BETA`) over `images` (`bop.Image`), and the lower one
    for boxes that lines of sight of another view confirm."""
    config, device = model.config, next(model.parameters()).device
    found, wanted = [], 0
    rng = np.random.default_rng(0)
    for start in tqdm(range(0, len(images), batch), unit="batch", desc="thresholds"):
        made = [searches.make(image, rng, augment=False) for image in images[start : start + batch]]
        stack = {name: torch.from_numpy(np.stack([x[name] for x in made])) for name in made[0]}
        x = normalised(stack["search_image"], stack["search_on_image"], config).to(device)
        for n, (boxes, scores, classes) in enumerate(boxes_of(model, x)):
            there = stack["search_boxes"][n][:, 2] > stack["search_boxes"][n][:, 0]
            truth, index = stack["search_boxes"][n][there], stack["search_class"][n][there]
            wanted += int((index >= 0).sum())
            found += matched(boxes.cpu(), scores.cpu(), classes.cpu(), truth, index)
    if not found or not wanted:
        return Thresholds(0.3, 0.15, 0.0, 0.0, 0.0)
    found.sort(reverse=True)
    score, iou = np.array(found).T
    right = np.cumsum(iou > 0)
    precision, recall = right / np.arange(1, len(right) + 1), right / wanted
    weighted = np.maximum(BETA**2 * precision + recall, 1e-9)
    best = int(((1 + BETA**2) * precision * recall / weighted).argmax())
    enough = int(np.searchsorted(recall, RECALL * recall[-1]))
    good = iou[: best + 1][iou[: best + 1] > 0]
    agree = min(score[best], max(score[min(enough, len(score) - 1)], LEAST))
    return Thresholds(
        round(float(score[best]), 3), round(float(agree), 3), float(precision[best]),
        float(recall[best]), float(good.mean()) if len(good) else 0.0,
    )  # fmt: skip

"""Boxes of a detector's maps, and which true boxes they find."""

import torch
import torch.nn.functional as F
from torchvision.ops import box_iou, nms

IOU = 0.5  # of a box that is right
UNSURE_IOU = 0.3  # with something that may be found or not, of a box that counts neither way
NMS_IOU = 0.5
LEAST = 0.05  # score


def peaks(scores: torch.Tensor, boxes: torch.Tensor, least: float = LEAST):
    """Per image: boxes [n, 4] px, scores [n], classes [n], of maps as the detector gives them.

    - scores [N, C, h, w]: 0 to 1
    - boxes [N, 4, h, w]: px
    - least: score
    """
    peak = (scores == F.max_pool2d(scores, 3, 1, 1)) & (scores >= least)
    for n in range(len(scores)):
        index, row, column = peak[n].nonzero(as_tuple=True)
        found, score = boxes[n][:, row, column].T, scores[n][index, row, column]
        apart = found + index[:, None] * 1e5  # classes do not suppress each other
        kept = nms(apart, score, NMS_IOU)
        yield found[kept], score[kept], index[kept]


def assigned(boxes, scores, classes, truth, index) -> list[tuple[int, int | None]]:
    """Of the boxes that count, best first, the number, and that of the true box that each finds, if
    any. Each true box is found once; those that may be found or not (class -1) count neither way.

    - boxes [n, 4], scores [n], classes [n]: what is found
    - truth [m, 4], index [m]: true boxes and their classes
    """
    sure = index >= 0
    iou = box_iou(boxes, truth) if len(truth) else torch.zeros(len(boxes), 0)
    free, out = sure.clone(), []
    for n in scores.argsort(descending=True).tolist():
        fits = iou[n] * (free & (index == classes[n]))
        best = int(fits.argmax()) if len(fits) else -1
        if best >= 0 and fits[best] >= IOU:
            free[best] = False
            out.append((n, best))
        elif not len(truth) or not (iou[n][~sure] > UNSURE_IOU).any():
            out.append((n, None))
    return out

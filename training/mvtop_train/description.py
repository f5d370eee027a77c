"""`model.json`, what a bundle says of itself."""

import copy
import json
from pathlib import Path

from .errors import asking_mvtop
from .files import read_json

NAME = "model.json"
# What `training/calibrate.py` fits of `inference`, by group; the rest of it is set by hand.
FITTED = {
    "rig": (
        "max_camera_deviation", "max_scale_deviation", "max_box_deviation", "unconfirmed_true",
    ),
    "search": ("min_confidence", "min_initial_log_odds"),
}  # fmt: skip
# What bundles of pipeline version 1 have.
EARLIER = "support_threshold", "print_threshold", "most_deviation"


def read(bundle: Path) -> dict:
    return read_json(bundle / NAME, "--bundle must name a bundle's folder")


def default_inference(group: str) -> dict:
    """Settings of a group of `inference`, as the core has them where a bundle says nothing."""
    with asking_mvtop("make wheel"):
        from mvtop._mvtop import default_inference  # loads its compiled part

    return json.loads(default_inference())[group]


def write(bundle: Path, description: dict):
    """Writes so that a kill leaves the old file or the new one."""
    part = bundle / f"{NAME}.part"
    part.write_text(json.dumps(description, indent=1) + "\n")
    part.replace(bundle / NAME)


def uncalibrated(about: dict) -> dict:
    """A copy of a description without anything that was fitted on predictions of its bundle."""
    about = copy.deepcopy(about)
    for name in ("scorer", "pipeline_version", "confidence"):
        about.pop(name, None)
    for name in EARLIER:
        about["detector"].pop(name, None)
    inference = about.pop("inference", {})
    for group, names in FITTED.items():
        kept = {k: v for k, v in inference.pop(group, {}).items() if k not in names}
        inference |= {group: kept} if kept else {}
    return about | ({"inference": inference} if inference else {})

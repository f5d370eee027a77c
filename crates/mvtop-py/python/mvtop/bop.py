"""Data sets in BOP's layout, and scores of results in its format (docs/how-to/evaluate-on-bop.md).

Read as `mvtop-cli eval bop` reads them, in metres.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from typing import Any

from mvtop._mvtop import (
    Image,
    Instance,
    ModelInfo,
    read_models_info,
    read_scene,
    score_results,
)

__all__ = ["Image", "Instance", "ModelInfo", "evaluate", "read_models_info", "read_scene"]

AnyPath = str | os.PathLike[str]


def evaluate(
    dataset: AnyPath,
    predictions: AnyPath | Iterable[AnyPath],
    *,
    split: str = "test",
    targets: AnyPath | None = None,
    sensor: str | None = None,
    objects: Iterable[int] | None = None,
    names: Mapping[str, int] | None = None,
    vsd_delta_mm: float = 15.0,
    report: AnyPath | None = None,
    force: bool = False,
) -> dict[str, Any]:
    """Scores of results in BOP's format, as `mvtop-cli eval bop --predictions` gives them.

    Warnings go to stderr.

    Parameters
    ----------
    dataset
        Folder of the data set, with its models and splits.
    predictions
        A CSV file, or several.
    split
        Name of the split.
    targets
        A file of BOP's test targets; every image by default.
    sensor
        CAM of scene_camera_CAM.json, where there are several; the one that BOP scores by default.
    objects
        Ids of those to evaluate; all by default.
    names
        Ids of objects that the files give by name.
    vsd_delta_mm
        How far a surface may lie behind the measured one and still count as seen, mm.
    report
        Folder for summary.json, groups.jsonl and report.html; what an evaluation of the same files
        wrote there is gone on with.
    force
        Whether it is begun anew instead.

    Returns
    -------
    dict
        Of one file what summary.json holds (docs/how-to/evaluate-on-bop.md); of several that, by
        the files' names without their ending.

    Raises
    ------
    OSError
        For files that are not there.
    ValueError
        For what is refused.
    """
    several = not isinstance(predictions, (str, os.PathLike))
    files = [predictions] if isinstance(predictions, (str, os.PathLike)) else list(predictions)
    if not files:
        raise ValueError("predictions: expected at least one file, got none")
    for path in (dataset, *files, *([targets] if targets is not None else [])):
        os.stat(path)
    scores = score_results(
        dataset,
        files,
        split=split,
        targets=targets,
        sensor=sensor,
        objects=None if objects is None else list(objects),
        names=list((names or {}).items()),
        vsd_delta_mm=vsd_delta_mm,
        report=report,
        force=force,
    )
    answer: dict[str, Any] = json.loads(scores)
    if several and len(files) == 1:
        return {os.path.splitext(os.path.basename(files[0]))[0]: answer}
    return answer

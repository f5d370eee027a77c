"""The verdict in words, and for programs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from mvtop.calibration.pipeline import Calibration
    from mvtop.calibration.verdict import HeldOut

HIGH = 95
"""Percentile that is said beside the median."""
LISTED = 8


def headline(told: Calibration) -> str:
    """The error on what was held out, in one sentence."""
    held = told.held_out
    if not held:
        return (
            "no exposure was held out (six are needed, without which the others still fix all "
            "cameras): "
            "the standard deviations are all there is"
        )
    distance = float(np.median([h.distance_m for h in held]))
    turn, across, along = summary(held)
    who = (
        "half of a board, against its other half"
        if len(told.cameras) == 1
        else "a board as one camera alone sees it, against where the other cameras see it"
    )
    return (
        f"held out, at {distance:.2f} m: {turn[0]:.3f} degrees and {across[0]:.2f} mm across "
        f"the line "
        f"of sight ({HIGH} %: {turn[1]:.3f} degrees, {across[1]:.2f} mm); along it "
        f"{along[0]:.2f} mm "
        f"({HIGH} %: {along[1]:.2f} mm): {who}"
    )


def summary(held: list[HeldOut]) -> list[tuple[float, float]]:
    """Median and high percentile of turns in degrees, of shifts across and along the sight in
    mm."""
    columns = np.array([[h.turn_deg, h.across_mm, h.along_mm] for h in held])
    middle, high = np.percentile(columns, [50, HIGH], axis=0)
    return [(float(m), float(h)) for m, h in zip(middle, high, strict=True)]


def text(told: Calibration) -> str:
    """Lines for people."""
    lines = []
    if told.note:
        lines.append(told.note)
    exposures = len(told.world_from_board)
    lines.append(
        f"{len(told.cameras)} camera{'s' * (len(told.cameras) != 1)}, {exposures} exposures of a "
        f"{told.board.kind}, {sum(c.views for c in told.cameras)} views"
    )
    lines.append("")
    header = ("camera", "views", "px", "turn sd", "place sd", "point sd", "image", "distance")
    rows = [header]
    for camera, cover in zip(told.cameras, told.coverage, strict=True):
        rows.append(
            (
                camera.camera,
                str(camera.views),
                f"{camera.px:.2f}",
                f"{camera.turn_sd_deg:.3f}°",
                f"{camera.shift_sd_mm:.2f} mm",
                f"{camera.point_sd_mm:.2f} mm",
                f"{cover.image:.0%}",
                f"{cover.nearest_m:.2f}-{cover.farthest_m:.2f} m",
            )
        )
    widths = [max(len(row[i]) for row in rows) for i in range(len(header))]
    for row in rows:
        lines.append("  ".join(cell.rjust(w) for cell, w in zip(row, widths, strict=True)))
    lines += ["", headline(told)]
    if told.outliers:
        lines.append(f"left out, {len(told.outliers)} of the views:")
        lines += [f"  {outlier}" for outlier in told.outliers[:LISTED]]
        if len(told.outliers) > LISTED:
            lines.append(f"  and {len(told.outliers) - LISTED} more")
    if told.scale is not None:
        lines.append(str(told.scale))
    lines += [f"warning: {warning}" for warning in told.warnings]
    return "\n".join(lines)


def to_dict(told: Calibration) -> dict[str, Any]:
    """Everything but images."""
    held = [vars(h) for h in told.held_out]
    verdict = None
    if held:
        names = ("turn_deg", "across_mm", "along_mm")
        pairs = zip(names, summary(told.held_out), strict=True)
        verdict = {name: {"median": m, f"p{HIGH}": h} for name, (m, h) in pairs}
    return {
        "format": "mvtop-calibration",
        "version": 1,
        "board": told.board.to_dict(),
        "reference": told.rig.reference,
        "cameras": [
            vars(c) | {"coverage": vars(v)}
            for c, v in zip(told.cameras, told.coverage, strict=True)
        ],
        "held_out": verdict,
        "held_out_views": held,
        "outliers": [vars(outlier) for outlier in told.outliers],
        "scale": None if told.scale is None else vars(told.scale) | {"factor": told.scale.factor},
        "warnings": told.warnings,
        "T_world_board": {key: pose.tolist() for key, pose in told.world_from_board.items()},
    }

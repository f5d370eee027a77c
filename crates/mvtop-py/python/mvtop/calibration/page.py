"""The verdict as an HTML page that needs no other file."""

from __future__ import annotations

import base64
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from mvtop.calibration import _need
from mvtop.calibration.report import LISTED, headline

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mvtop.calibration.pipeline import Calibration

STYLE = """
body { font: 14px sans-serif; margin: 24px; max-width: 1240px }
table { border-collapse: collapse; margin: 12px 0 }
td, th { border: 1px solid #ccc; padding: 3px 8px; text-align: right }
th { background: #f4f4f4 }
td:first-child, th:first-child { text-align: left }
figure { display: inline-block; margin: 6px 12px 6px 0; vertical-align: top }
figcaption { max-width: 560px; font-size: 13px }
"""
PICTURE_WIDTH = 560
ENLARGED = 30.0
"""By how much residuals are drawn longer."""


def page(told: Calibration) -> str:
    """HTML with all pictures in it."""
    rows = []
    for camera, cover in zip(told.cameras, told.coverage, strict=True):
        cells = [
            escape(camera.camera),
            camera.views,
            f"{camera.px:.3f}",
            f"{camera.turn_sd_deg:.4f}",
            f"{camera.shift_sd_mm:.3f}",
            f"{camera.point_sd_mm:.3f}",
            f"{camera.focal_sd_px:.2f}",
            f"{cover.image:.0%}",
            f"{cover.nearest_m:.2f} to {cover.farthest_m:.2f}",
            f"{cover.tilt_deg:.0f}",
        ]
        rows.append("<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>")
    names = (
        "camera|views|residual, px|direction, sd, degrees|place, sd, mm|point amid the boards, "
        "sd, mm|"
        "focal length, sd, px|image covered|boards at, m|greatest tilt, degrees"
    ).split("|")
    parts = [
        "<!DOCTYPE html><html lang=en><head><meta charset=utf-8><title>mvtop: calibration</title>",
        f"<style>{STYLE}</style></head><body><h1>Calibration of a rig</h1>",
        f"<p>{escape(headline(told))}</p>",
        _list("Warnings", told.warnings),
        _list("Views left out", [str(outlier) for outlier in told.outliers]),
        f"<p>{escape(str(told.scale))}</p>" if told.scale is not None else "",
        "<h2>Cameras</h2><table><tr>",
        "".join(f"<th>{name}</th>" for name in names) + "</tr>" + "".join(rows) + "</table>",
        "<p>Standard deviations (sd) are against the reference camera "
        f"<b>{escape(told.rig.reference)}</b>.</p>",
        _held(told),
        "<h2>What each camera saw</h2>",
    ]
    for camera in told.cameras:
        parts.append(_figure(_corners(told, camera.camera), f"{camera.camera}: all corners"))
        if worst := _worst(told, camera.camera):
            picture = _residuals(told, camera.camera, worst)
            words = (
                f"exposure {worst}, the worst that was kept; residuals {ENLARGED:g} times as long"
            )
            parts.append(_figure(picture, f"{camera.camera}: {words}"))
    for outlier in told.outliers[:LISTED]:
        picture = _plain(told, outlier.camera, outlier.exposure)
        parts.append(_figure(picture, f"left out: {outlier}"))
    return "\n".join([*parts, "</body></html>\n"])


def _list(title: str, sentences: list[str]) -> str:
    if not sentences:
        return ""
    items = "".join(f"<li>{escape(sentence)}</li>" for sentence in sentences)
    return f"<h2>{title}</h2><ul>{items}</ul>"


def _held(told: Calibration) -> str:
    if not told.held_out:
        return ""
    rows = []
    for camera in told.cameras:
        own = [h for h in told.held_out if h.camera == camera.camera]
        if own:
            numbers = np.array([[h.turn_deg, h.across_mm, h.along_mm, h.px] for h in own])
            middle, most = np.median(numbers, axis=0), numbers.max(axis=0)
            cells = [f"{m:.3f} ({w:.3f})" for m, w in zip(middle, most, strict=True)]
            cells = [escape(camera.camera), str(len(own)), *cells]
            rows.append("<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>")
    head = "camera|views|turn, degrees|across the sight, mm|along the sight, mm|residual, px".split(
        "|"
    )
    return (
        "<h2>Exposures held out: median (worst)</h2><table><tr>"
        + "".join(f"<th>{name}</th>" for name in head)
        + f"</tr>{''.join(rows)}</table>"
    )


def _figure(picture: NDArray[np.uint8], words: str) -> str:
    cv2 = _need.opencv()
    _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 80])
    source = base64.b64encode(data.tobytes()).decode()
    return (
        f'<figure><img src="data:image/jpeg;base64,{source}" alt="">'
        f"<figcaption>{escape(words)}</figcaption></figure>"
    )


def _small(image: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], float]:
    cv2 = _need.opencv()
    scale = PICTURE_WIDTH / image.shape[1]
    size = (PICTURE_WIDTH, max(1, round(image.shape[0] * scale)))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return cv2.cvtColor(small, cv2.COLOR_GRAY2BGR), scale


def _corners(told: Calibration, camera: str) -> NDArray[np.uint8]:
    """All corners of a camera's views on one of its images."""
    cv2 = _need.opencv()
    seen = told.observations.found[camera]
    kept = [exposure for name, exposure in told.residuals if name == camera]
    picture, scale = _small(told.observations.image(camera, kept[0]))
    picture = (picture // 2 + 96).astype(np.uint8)
    for exposure in kept:
        for x, y in (seen[exposure].pixels + 0.5) * scale - 0.5:
            cv2.circle(picture, (round(x), round(y)), 2, (180, 60, 20), -1, cv2.LINE_AA)
    return picture


def _worst(told: Calibration, camera: str) -> str | None:
    own = {e: float(np.mean(r**2)) for (name, e), r in told.residuals.items() if name == camera}
    return max(own, key=lambda exposure: own[exposure]) if own else None


def _residuals(told: Calibration, camera: str, exposure: str) -> NDArray[np.uint8]:
    cv2 = _need.opencv()
    picture, scale = _small(told.observations.image(camera, exposure))
    pixels = told.observations.found[camera][exposure].pixels
    for at, off in zip(pixels, told.residuals[camera, exposure], strict=True):
        start = (at + 0.5) * scale - 0.5
        end = start + off * ENLARGED
        cv2.line(picture, _whole(start), _whole(end), (0, 0, 220), 1, cv2.LINE_AA)
        cv2.circle(picture, _whole(start), 2, (0, 160, 0), -1, cv2.LINE_AA)
    return picture


def _plain(told: Calibration, camera: str, exposure: str) -> NDArray[np.uint8]:
    cv2 = _need.opencv()
    picture, scale = _small(told.observations.image(camera, exposure))
    for at in told.observations.found[camera][exposure].pixels:
        cv2.circle(picture, _whole((at + 0.5) * scale - 0.5), 3, (0, 0, 220), 1, cv2.LINE_AA)
    return picture


def _whole(point: NDArray[np.float64]) -> tuple[int, int]:
    x, y = np.clip(point, -1e4, 1e4).round().astype(int)
    return int(x), int(y)

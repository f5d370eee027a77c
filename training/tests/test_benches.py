"""The benchmarks' own scenes and figures: what `make bench-predict` is made of."""

import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "benches"))

import predict  # noqa: E402
import predict_scene  # noqa: E402


def test_a_scene_shows_its_parts_in_each_view():
    table = predict_scene.Table(ROOT / "models/ycbv4")
    empty, full = (table.render(1, count, (160, 120), 2) for count in (0, 3))
    for nothing, parts in zip(empty, full, strict=True):
        assert parts.shape == (120, 160, 3)
        # A floor is smooth.
        changes = [np.abs(np.diff(image.astype(int), axis=1)).max() for image in (nothing, parts)]
        assert changes[0] < 10 < 30 < changes[1]


def row(cores: int, **stages: float) -> dict:
    return {"case": {"cores": cores}, "stages_ms": stages, "tracked_ms": None}


def test_the_serial_share_is_what_a_second_core_does_not_shorten():
    # `refine` is halved; of 100 ms of `crop` 40 stay as they are, and 60 are halved.
    rows = [row(1, refine=300.0, crop=100.0), row(2, refine=150.0, crop=70.0)]
    shares = predict.serial(rows)
    assert shares == pytest.approx({"refine": 0.0, "crop": 0.4, "total": 0.1})
    (note,) = predict.notes({"cores": {"rows": rows}})
    # 40 ms, and 360 by 4 and by 8 cores.
    assert "would take 130 and 85 ms" in note

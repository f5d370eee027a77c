"""Confidences: what is fitted says how often poses are right."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from mvtop_train.data import objects
from mvtop_train.training import confidence
from mvtop_train.training.confidence import Judged


def poses(count: int, seed: int = 0) -> list[Judged]:
    """Right with the odds exp(2 - 3 a), whatever b is; c is always the same."""
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(2, count))
    right = rng.random(count) < 1 / (1 + np.exp(3 * a - 2))
    return [
        Judged({"a": x, "b": y, "c": 7.0}, bool(z), None, 2, False)
        for x, y, z in zip(a, b, right, strict=True)
    ]


def test_odds_are_found_again():
    fitted = confidence.fit(poses(20_000))
    assert fitted["weights"]["a"] == pytest.approx(-3, abs=0.1)
    assert fitted["weights"].get("b", 0) == pytest.approx(0, abs=0.1)
    assert "c" not in fitted["weights"]
    assert fitted["bias"] == pytest.approx(2, abs=0.1)
    assert (fitted["within_deg"], fitted["within_m"]) == (5, 0.005)


def test_what_is_said_comes_true_on_others():
    fitted, others = confidence.fit(poses(500)), poses(20_000, 1)
    odds = [fitted["bias"] + fitted["weights"]["a"] * one.evidence["a"] for one in others]
    said = 1 / (1 + np.exp(-np.array(odds)))
    rows, error = confidence.reliability(said, np.array([one.right for one in others]))
    assert rows[:, 0].sum() == 20_000 and (np.diff(rows[:, 1]) > 0).all()
    assert error < 0.05


def test_calibration_error_by_hand():
    said = np.repeat([0.1, 0.9], 50)
    right = np.r_[np.zeros(40), np.ones(10), np.ones(50)]  # 20 % and 100 %
    rows, error = confidence.reliability(said, right)
    assert len(rows) == 10
    # Each bin has ten poses of one kind; of the first five, one holds all ten right ones.
    assert error == pytest.approx((4 * 0.1 + 0.9 + 5 * 0.1) / 10)


def test_too_little_gives_none():
    assert confidence.fit(poses(99)) is None
    always = [Judged(one.evidence, True, None, 2, False) for one in poses(200)]
    assert confidence.fit(always) is None


def test_right_is_within_both_bounds_and_of_the_same_class():
    ball = objects.ball()

    def pose(deg: float, mm: float):
        out = np.eye(4)
        c, s = np.cos(np.radians(deg)), np.sin(np.radians(deg))
        out[:2, :2] = [[c, -s], [s, c]]
        out[0, 3] = mm / 1e3
        return out

    def right(deg, mm, obj_id=ball.id):
        one = SimpleNamespace(world_from_obj=pose(deg, mm))
        return confidence.is_right(one, [(obj_id, np.eye(4))], ball)

    assert right(4.9, 4.9) and not right(5.1, 0) and not right(0, 5.1)
    assert not right(0, 0, ball.id + 1)


def test_stands_in_the_bundle_after_the_detector(tmp_path):
    description = {"format": "mvtop-model", "detector": {}, "graphs": {}}
    (tmp_path / "model.json").write_text(json.dumps(description))
    for bias in (1.0, 2.0):
        confidence.add(tmp_path, {"bias": bias})
    written = json.loads((tmp_path / "model.json").read_text())
    assert list(written) == ["format", "detector", "confidence", "graphs"]
    assert written["confidence"] == {"bias": 2.0}

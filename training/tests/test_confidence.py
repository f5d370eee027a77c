"""Confidences: what is fitted says how often poses are right."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from mvtop_train.data import objects
from mvtop_train.errors import UserError
from mvtop_train.study import reliability
from mvtop_train.training import confidence
from mvtop_train.training.confidence import Judged


def poses(count: int, seed: int = 0, views: int = 2, slope: float = -3.0) -> list[Judged]:
    """Right with the odds exp(2 + slope a + d^2 / 2), whatever b is; c is always the same."""
    rng = np.random.default_rng(seed)
    a, b, d = rng.uniform(-2, 2, size=(3, count))
    right = rng.random(count) < 1 / (1 + np.exp(-slope * a - d**2 / 2 - 2))
    return [
        Judged(
            {"a": w, "b": x, "c": 7.0, "d": y, "views": np.log(views)}, bool(z), None, views, False
        )
        for w, x, y, z in zip(a, b, d, right, strict=True)
    ]


def said(odds: dict, evidence: dict[str, float]) -> float:
    """As `mvtop-core/src/confidence.rs`."""
    total = odds["bias"]
    for name, value in evidence.items():
        value = np.clip(value, *odds["limits"].get(name, (value, value)))
        total += odds["weights"].get(name, 0) * value + odds["squares"].get(name, 0) * value**2
    return 1 / (1 + np.exp(-total))


def test_odds_are_found_again():
    fitted = confidence.fit(poses(40_000))
    assert fitted["weights"]["a"] == pytest.approx(-3, abs=0.1)
    assert fitted["squares"]["d"] == pytest.approx(0.5, abs=0.1)
    for kind, name in (("weights", "b"), ("weights", "d"), ("squares", "a"), ("squares", "b")):
        assert fitted[kind][name] == pytest.approx(0, abs=0.1)
    assert "c" not in fitted["weights"]
    assert fitted["bias"] == pytest.approx(2, abs=0.1)
    assert (fitted["within_deg"], fitted["within_m"]) == (5, 0.005)
    assert fitted["limits"]["a"] == pytest.approx([-1.96, 1.96], abs=0.03)


@pytest.mark.parametrize(
    ("odd", "value"), [(5, 0.75), (5, 0.98), (4, 0.75), (6, 0.75), (6, 0.9999)]
)
def test_evidence_that_is_nearly_always_the_same_has_weights_that_bundles_take(odd, value):
    found = poses(500)
    for n, one in enumerate(found):
        one.evidence["c"] = 1.0 if n >= odd else value
    fitted = confidence.fit(found)
    for kind in ("weights", "squares"):
        assert max(abs(weight) for weight in fitted[kind].values()) < 1e5
    assert fitted["weights"]["a"] == pytest.approx(-3, abs=1)


def test_what_one_view_shows_has_its_own_odds():
    found = [*poses(20_000), *poses(20_000, 1, views=1, slope=1.0)]
    fitted = confidence.fit(found)
    assert fitted["weights"]["a"] == pytest.approx(-3, abs=0.2)
    assert fitted["one_view"]["weights"]["a"] == pytest.approx(1, abs=0.1)
    # Too few of these: one fit of all.
    assert "one_view" not in confidence.fit([*poses(1000), *poses(99, 1, views=1)])


def test_what_is_said_comes_true_on_others():
    fitted, others = confidence.fit(poses(500)), poses(20_000, 1)
    told = np.array([said(fitted, one.evidence) for one in others])
    rows, error = confidence.reliability(told, np.array([one.right for one in others]))
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


def test_results_are_judged_by_both_bounds(tmp_path):
    row = {"rot_deg": 4.9, "trans_m": 0.0049, "confidence": 0.75, "views": 2}
    rows = [row, row | {"rot_deg": 5.1}, row | {"trans_m": 0.0051}, row | {"confidence": None}]
    path = tmp_path / "results.jsonl"
    path.write_text("\n".join(map(json.dumps, rows)))
    found = reliability.read(path)
    assert [one.right for one in found] == [True, False, False]
    assert {one.confidence for one in found} == {0.75}
    path.write_text("{}")
    assert reliability.read(path) == []  # nothing was found
    path.write_text("poses")
    with pytest.raises(UserError, match="eval samples --out"):
        reliability.read(path)

"""The accuracy yardstick: groups, outcomes, intervals, runs that go on, what counts as worse."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from mvtop_train.data import bop
from mvtop_train.errors import UserError
from mvtop_train.evaluation import accuracy, groups, outcomes, running, statistics
from mvtop_train.evaluation.sets import TestSet, fixed
from mvtop_train.network.config import ObjectClass

NUT = ObjectClass(1, "nut", 0.5)
BOLT = ObjectClass(2, "bolt", 0.5)
HALF_TURN = (-1.0, 0, 0, 0, 0, -1.0, 0, 0, 0, 0, 1.0, 0, 0, 0, 0, 1.0)


def at(x: float, y: float = 0.0, turn_deg: float = 0.0) -> np.ndarray:
    pose, angle = np.eye(4), np.deg2rad(turn_deg)
    pose[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    pose[:3, 3] = x, y, 1.0
    return pose


def estimate(obj: ObjectClass, pose: np.ndarray, confidence: float | None = 0.5):
    sigma = SimpleNamespace(rot_deg=2.0, t_m=0.001)
    return SimpleNamespace(
        class_name=obj.name, world_from_obj=pose, confidence=confidence, sigma=sigma
    )


def group(*truth: groups.Truth, name: str = "0/0") -> groups.Group:
    return groups.Group(name, name.split("/")[0], None, {}, truth, frozenset({"nut", "bolt"}))


def prediction(*found):
    return SimpleNamespace(objects=list(found), warnings=[], timings_ms={"total": 20.0})


def test_estimates_are_matched_one_to_one_nearest_first_within_their_class_and_diameter():
    truth = tuple(groups.Truth(k, at(x), {}) for k, x in ((NUT, 0), (NUT, 1), (BOLT, 1.1)))
    found = [estimate(NUT, at(x)) for x in (0.4, 0.1, 9.0)]
    assert outcomes.matches(truth, found) == [1, None, None]  # 0.4 is 0.6 off the second
    found[0] = estimate(NUT, at(0.55))
    assert outcomes.matches(truth, found) == [1, 0, None]
    found = [estimate(NUT, at(1.1)), estimate(BOLT, at(1.1)), estimate(NUT, at(0.95))]
    assert outcomes.matches(truth, found) == [None, 2, 1]


def test_an_outcome_tells_what_is_right_found_missed_and_invented():
    truth = [
        groups.Truth(NUT, at(0), {"a": 0.25}),
        groups.Truth(NUT, at(1), {}),
        groups.Truth(BOLT, at(2), {}),
        groups.Truth(BOLT, at(4), {}, counts=False),  # beside the first image
    ]
    found = [
        estimate(NUT, at(0.003, turn_deg=4)),
        estimate(NUT, at(1, turn_deg=6), 0.1),
        estimate(BOLT, at(4)),
        estimate(BOLT, at(9), 0.9),
    ]
    told = outcomes.outcome(group(*truth), prediction(*found))
    first, second, third = told["objects"]
    assert (first["found"], first["right"], first["visibility"]) == (True, True, {"a": 0.25})
    assert first["rot_err_deg"] == pytest.approx(4) and first["t_err_mm"] == pytest.approx(3)
    assert first["sigma_t_mm"] == 1.0 and first["confidence"] == 0.5
    assert (second["found"], second["right"]) == (True, False)
    assert (third["found"], third["right"]) == (False, False)
    assert told["false_positives"] == [{"class": "bolt", "confidence": 0.9}]
    assert json.loads(json.dumps(told)) == told


def test_what_a_model_is_not_asked_for_is_no_false_positive():
    washer = ObjectClass(3, "washer", 0.1)
    told = outcomes.outcome(group(), prediction(estimate(washer, at(0))))
    assert told["false_positives"] == []


def test_of_a_rig_that_is_refused_all_is_missed():
    told = outcomes.outcome(group(groups.Truth(NUT, at(0), {})), ValueError("no rig"))
    assert told["error"] == "no rig" and not told["objects"][0]["found"]


def test_turns_that_nobody_sees_are_no_errors():
    shaft = ObjectClass(4, "shaft", 0.1, continuous=((0.0, 0, 1, 0, 0, 0),))
    plate = ObjectClass(5, "plate", 0.1, discrete=(HALF_TURN,))
    assert outcomes.errors(at(0), at(0.002, turn_deg=77), shaft) == pytest.approx(
        (0, 0.002), abs=1e-4
    )
    rot_deg, t_m = outcomes.errors(at(0), at(0, turn_deg=177), plate)
    assert (rot_deg, t_m) == pytest.approx((3, 0), abs=1e-4)


def test_groups_are_those_of_eval_bop():
    # 46 images, four views: others of 45 at 10, 22, 33 after the reference.
    assert groups.choices(46, 4, False)[:2] == [[0, 11, 23, 34], [1, 12, 24, 35]]
    assert groups.choices(46, 4, False)[45] == [45, 10, 22, 33]
    assert groups.choices(3, 2, False) == [[0, 1], [1, 2], [2, 0]]
    assert groups.choices(4, 2, True) == [[0, 2], [1, 3]]
    assert groups.choices(8, 3, True) == [[0, 2, 5], [1, 3, 6]]
    assert groups.choices(3, 3, True) == [[0, 1, 2]] and groups.choices(2, 3, False) == []


def test_what_the_first_image_does_not_show_does_not_count():
    def image(*poses) -> bop.Image:
        seen = [bop.Instance(1, pose, None, visible_share=0.5) for pose in poses]
        return bop.Image(0, Path(), np.eye(3), np.eye(4), seen)

    truth = groups.truth_of([image(at(0), at(1)), image(at(0.05), at(3))], {1: NUT})
    assert [(t.world_from_obj[0, 3], t.counts) for t in truth] == [(0, True), (1, True), (3, False)]
    assert [t.visibility for t in truth] == [{"0": 0.5, "1": 0.5}, {"0": 0.5}, {"1": 0.5}]


def result(
    scene: int, right: bool, extra: int = 0, confidence: float = 0.5, time_ms: float = 100
) -> dict:
    one = {
        "class": "nut", "visibility": {}, "found": True, "right": right, "confidence": confidence,
        "rot_err_deg": 4.0, "t_err_mm": 1.0, "sigma_rot_deg": 2.0, "sigma_t_mm": 2.0,
    }  # fmt: skip
    return {
        "group": f"{scene}/0", "scene": str(scene), "images": [], "objects": [one],
        "false_positives": [{"class": "nut", "confidence": 0.1}] * extra,
        "timings_ms": {"total": time_ms}, "warnings": [], "error": None,
    }  # fmt: skip


def test_measures_of_a_run_worked_by_hand():
    told = statistics.summary([result(0, True, 2, 0.9), result(1, False, 0, 0.3, 300)])
    assert (told["objects"], told["found"], told["right"], told["invented"]) == (2, 2, 1, 2)
    assert (told["recall"], told["false_positives"], told["auroc"]) == (0.5, 1.0, 1.0)
    # Four estimates, a bin each: off by 0.1, 0.3, 0.1, 0.1.
    assert told["ece"] == pytest.approx(0.15)
    assert (told["ratio_rot_median"], told["ratio_t_mean"]) == (2.0, 0.5)
    assert (told["time_ms_median"], told["time_ms_mean"]) == (200, 200)
    assert told["at_least"] == {"0.2": (0.5, 0.5), "0.5": (0.5, 1.0), "0.8": (0.5, 1.0)}


def test_of_equal_runs_the_difference_is_zero_and_certain():
    run = [result(n, n % 3 == 0, n % 2) for n in range(20)]
    told = statistics.compared(run, run, 200)
    for name in ("recall", "false_positives", "time_ms_mean"):
        assert told[name]["difference"] == 0 and told[name]["interval"] == [0, 0]
    assert statistics.worse("set", told) is None


def test_intervals_are_those_of_paired_scenes():
    """Of 100 scenes 20 are lost: a share of 0.2, of standard deviation 0.04."""
    a = [result(n, True) for n in range(100)]
    b = [result(n, n >= 20, time_ms=150) for n in range(100)]
    told = statistics.compared(a, b)
    assert told["recall"]["difference"] == pytest.approx(-0.2)
    assert told["recall"]["interval"] == pytest.approx([-0.28, -0.12], abs=0.015)
    assert told["time_ms_mean"]["interval"] == [50, 50]
    assert told == statistics.compared(a, b)  # seeded
    # As many lost as won: no difference, a wide interval.
    a = [result(n, n % 2 == 0) for n in range(100)]
    b = [result(n, n % 2 == 1) for n in range(100)]
    low, high = statistics.compared(a, b)["recall"]["interval"]
    assert low == pytest.approx(-0.2, abs=0.03) and high == pytest.approx(0.2, abs=0.03)


def test_groups_of_one_scene_are_drawn_together_unless_there_is_one_scene():
    def of(scenes: int) -> float:
        names = [(n % scenes, n) for n in range(40)]
        a = [result(s, True) | {"group": str(n)} for s, n in names]
        b = [result(s, s % 4 != 0 if scenes > 1 else n % 4 != 0) for s, n in names]
        low, high = statistics.compared(a, b)["recall"]["interval"]
        return high - low

    assert of(4) > 1.5 * of(40)  # of ten groups each, all alike
    assert of(1) == pytest.approx(of(40), rel=0.2)


def test_worse_is_what_exceeds_chance():
    a = [result(n, True) for n in range(50)]
    lost = statistics.compared(a, [result(n, n > 10) for n in range(50)])
    assert statistics.worse("ball", lost).startswith(
        "ball: recall is lower: 0.780 instead of 1.000"
    )
    chance = statistics.compared(a, [result(n, n > 0) for n in range(50)])
    assert chance["recall"]["difference"] < 0 and statistics.worse("ball", chance) is None
    more = statistics.compared(a, [result(n, True, n % 2) for n in range(50)])
    assert "false positives per group are more: 0.500" in statistics.worse("ball", more)
    better = statistics.compared([result(n, n > 10, 1) for n in range(50)], a)
    assert statistics.worse("ball", better) is None


def results(path: Path, **sets) -> str:
    running.write(path, {
        "format": 1, "machine": {"processor": "p"}, "date": "d", "commit": "c", "build": "b",
        "options": {},
        "sets": {
            name: {"model": "m", "bundle": "x", "views": 2, "groups": groups}
            for name, groups in sets.items()
        },
    })  # fmt: skip
    return str(path)


def told(monkeypatch, capsys, *arguments) -> tuple[str, str | int]:
    """What the command prints, and what it exits with."""
    monkeypatch.setattr("sys.argv", ["accuracy", *arguments])
    code = 0
    try:
        accuracy.main()
    except SystemExit as end:
        code = end.code
    return capsys.readouterr().out, code


def test_compare_exits_with_a_sentence_for_each_set_that_is_worse(monkeypatch, capsys, tmp_path):
    good, bad = ([result(n, right) for n in range(20)] for right in (True, False))
    a = results(tmp_path / "a.json", ball=good, parts=good, rest=good)
    b = results(tmp_path / "b.json", ball=bad, parts=good)
    out, code = told(monkeypatch, capsys, "compare", a, b)
    assert code == 0 and "ball (20 groups)" in out and "-1.000 to -1.000  *" in out
    out, code = told(monkeypatch, capsys, "compare", a, b, "--fail-if-worse")
    lines = code.splitlines()
    assert len(lines) == 2 and all(line.startswith("error: ") for line in lines)
    assert "rest: expected results" in lines[0] and "ball: recall is lower" in lines[1]
    assert told(monkeypatch, capsys, "compare", b, b, "--fail-if-worse")[1] == 0
    found = json.loads(told(monkeypatch, capsys, "compare", a, b, "--json")[0])
    assert found["ball"]["measures"]["recall"]["interval"] == [-1, -1]
    shown, code = told(monkeypatch, capsys, "show", a)
    assert code == 0 and shown.startswith("d, commit c, p") and "recall at 0.8" in shown
    other = results(tmp_path / "c.json", other=good)
    assert "sets that both files have" in told(monkeypatch, capsys, "compare", a, other)[1]


class Stopped(Exception):
    pass


@pytest.fixture
def run(monkeypatch, tmp_path):
    """Runs a set of six groups with a made-up estimator, which stops at some group."""
    asked = []
    model = tmp_path / "model"
    model.mkdir()
    (model / "model.json").write_text(
        json.dumps({"classes": [{"id": 1, "name": "nut", "diameter_m": 0.5}]})
    )

    def load(n: int) -> groups.Group:
        asked.append(n)
        return group(groups.Truth(NUT, at(n), {}), name=f"{n}/0")

    planned = [groups.Planned(f"{n}/0", str(n), lambda n=n: load(n)) for n in range(6)]
    monkeypatch.setattr(TestSet, "missing", lambda *_: None)
    monkeypatch.setattr(TestSet, "planned", lambda self, classes, limit: planned[:limit])

    def run(out: Path, stop: int | None = None, limit: int | None = None, options: dict = {}):  # noqa: B006
        class Estimator:
            def predict(self, images, rig, **options):
                if asked[-1] == stop:
                    raise Stopped
                return prediction(estimate(NUT, at(asked[-1])))

        monkeypatch.setattr(running, "loaded", lambda bundle, options: (Estimator(), {}))
        asked.clear()
        sets = [TestSet("nuts", "nuts", 1, ()), TestSet("bolts", "bolts", 1, ())]
        running.run(out, sets, {"nuts": model}, limit, options)
        return list(asked)

    run.model = model
    return run


def test_a_run_that_was_stopped_goes_on(run, tmp_path, capsys):
    out = tmp_path / "there" / "out.json"
    with pytest.raises(Stopped):
        run(out, stop=4)
    assert len(running.read(out)["sets"]["nuts"]["groups"]) == 4
    capsys.readouterr()
    assert run(out, limit=5) == [4]
    assert capsys.readouterr().out == "bolts: left out, as it needs --model-bolts\n"
    assert run(out) == [5] and run(out) == []
    names = [one["group"] for one in running.read(out)["sets"]["nuts"]["groups"]]
    assert names == [f"{n}/0" for n in range(6)]
    # Those of a whole run, but for times.
    assert run(tmp_path / "other.json") == [0, 1, 2, 3, 4, 5]
    again = running.read(tmp_path / "other.json")
    assert again["sets"] == running.read(out)["sets"]


def test_results_of_another_build_option_or_bundle_are_not_gone_on_with(run, tmp_path, monkeypatch):
    out = tmp_path / "out.json"
    run(out, limit=1)
    with pytest.raises(UserError, match="the same --option"):
        run(out, options={"refine": False})
    (run.model / "other").write_text("weights")
    with pytest.raises(UserError, match="bundle that .* is now"):
        run(out)
    monkeypatch.setattr(running, "digest", lambda *_: "another")
    with pytest.raises(UserError, match="the same build of mvtop"):
        run(out)


def test_options_are_json_or_text_and_their_prefix_says_whose_they_are():
    told = running.options_of(["refine=false", "min_views=2", "reference=left", "load.threads=1"])
    assert told == {"refine": False, "min_views": 2, "reference": "left", "load.threads": 1}
    with pytest.raises(UserError, match="KEY=VALUE"):
        running.options_of(["refine"])


def test_options_of_the_bundle_replace_what_it_says_of_itself():
    changed = {"bundle.detector.score_threshold": 1.0, "refine": False}
    estimator, kept = running.loaded(Path("models/mvball"), changed)
    assert kept == {"refine": False}
    shipped = fixed()["example-mvball"]
    (plan,) = shipped.planned(groups.classes_of(Path("models/mvball")), None)
    one = plan.load()
    assert not outcomes.outcome(one, estimator.predict(one.images, one.rig))["objects"][0]["found"]
    with pytest.raises(UserError, match="bundle.nothing.there"):
        running.loaded(Path("models/mvball"), {"bundle.nothing.there": 1})
    with pytest.raises(UserError, match="fix"):
        running.loaded(Path("models/mvball"), {"load.engine": 1})


def test_the_shipped_example_is_right(tmp_path):
    models = {"mvball": Path("models/mvball")}
    told = running.run(tmp_path / "out.json", [fixed()["example-mvball"]], models, None, {})
    (one,) = told["sets"]["example-mvball"]["groups"]
    assert one["objects"][0]["right"] and one["error"] is None and one["timings_ms"]["total"] > 0
    assert running.read(tmp_path / "out.json") == told
    with pytest.raises(UserError, match="--option"):
        options = {"nothing": 1}
        running.run(tmp_path / "b.json", [fixed()["example-mvball"]], models, None, options)


def test_a_set_that_is_not_there_is_left_out_with_a_sentence(tmp_path, capsys):
    gone = TestSet("gone", "mvball", 2, (tmp_path / "gone",))
    with pytest.raises(UserError, match="no set could be run"):
        running.run(tmp_path / "out.json", [gone], {"mvball": Path("models/mvball")}, None, {})
    assert "gone: left out: " in capsys.readouterr().out
    made = []
    half = TestSet("half", "mvball", 2, (tmp_path / "0", tmp_path / "1"), parts=10,
                   make=lambda folder, count: made.append((folder.name, count)))  # fmt: skip
    for folder in half.folders:
        for n in range(10 if folder.name == "0" else 3):
            (folder / f"{n:06d}").mkdir(parents=True)
            (folder / f"{n:06d}" / "truth.json").touch()
    assert half.missing(12) is None and made == []  # two of the second folder are enough
    assert half.missing(None) is None and made == [("1", 10)]


def test_the_names_of_sets_are_known():
    usual = [name for name, one in fixed().items() if one.usual]
    assert usual == [
        "ball", "parts-4", "parts-2", "ycbv4-3", "ycbv4-2", "path-ball", "path-ycb-3", "path-ycb-2",
        "path-parts-4", "path-parts-2", "photos-2", "photos-3", "photos-4", "photos-6", "scene59-3",
    ]  # fmt: skip

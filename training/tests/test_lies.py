"""Lies about calibrations and images: what each one is, how poses are judged, what is counted."""

import json
from pathlib import Path
from types import SimpleNamespace

import mvtop
import numpy as np
import pytest

from mvtop_train.errors import UserError
from mvtop_train.evaluation import groups, lies, noticed, running, shots, tellings
from mvtop_train.evaluation.sets import TestSet
from mvtop_train.network.config import ObjectClass

REPO = Path(__file__).parents[2]
NUT = ObjectClass(1, "nut", 0.1)
K = np.array([[500.0, 0, 40], [0, 510, 30], [0, 0, 1]])
SIZE = (80, 60)
EVERY = {
    name: (kind, lie) for kind, of_kind in tellings.LIES.items() for name, lie in of_kind.items()
}


def look(x: float, turn_deg: float = 0.0) -> np.ndarray:
    """world_from_cam of a camera beside the world's origin."""
    pose, angle = np.eye(4), np.deg2rad(turn_deg)
    pose[:3, :3] = [
        [np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]
    ]  # fmt: skip
    pose[0, 3] = x
    return pose


def there(x: float = 0.0, z: float = 0.8) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = x, 0, z
    return pose


def made(views: int, scene: int = 0) -> groups.Group:
    """A nut before cameras in a row; each image has values of its own."""
    cameras = [
        mvtop.Camera(K, SIZE, world_from_cam=look(0.3 * n, -20 * n), id=f"c{n}")
        for n in range(views)
    ]
    rng = np.random.default_rng(scene)
    images = {c.id: rng.integers(0, 256, (60, 80, 3), np.uint8) for c in cameras}
    truth = (groups.Truth(NUT, there(), dict.fromkeys(images)),)
    name = f"{scene}/0"
    return groups.Group(name, str(scene), mvtop.Rig(cameras), images, truth, frozenset({"nut"}))


@pytest.fixture(scope="module")
def three():
    return made(3)


def told(name: str, true: shots.Shots) -> shots.Shots:
    return EVERY[name][1](true, np.random.default_rng(1))


def angle_deg(a: shots.Shot, b: shots.Shot) -> float:
    between = a.world_from_cam[:3, :3].T @ b.world_from_cam[:3, :3]
    return float(np.rad2deg(np.arccos(np.clip((np.trace(between) - 1) / 2, -1, 1))))


def test_lies_are_what_their_names_say(three):
    true = shots.of_group(three)
    last = true[-1]
    for degrees in (1, 2, 5):
        name = f"last camera turned by {degrees} degree" + "s" * (degrees > 1)
        assert angle_deg(last, told(name, true)[-1]) == pytest.approx(degrees)
    rolled = told("last camera rolled by 90 degrees", true)[-1]
    assert angle_deg(last, rolled) == pytest.approx(90)
    np.testing.assert_allclose(rolled.world_from_cam[:, 2], last.world_from_cam[:, 2])  # its axis
    for mm in (10, 20, 50):
        off = told(f"last camera moved by {mm} mm", true)[-1].world_from_cam - last.world_from_cam
        assert 1e3 * np.linalg.norm(off[:3, 3]) == pytest.approx(mm)

    def distance(rig):
        return np.linalg.norm(rig[0].world_from_cam[:3, 3] - rig[-1].world_from_cam[:3, 3])

    for factor, name in ((1.01, "1 % too long"), (0.95, "5 % too short")):
        other = told(f"translations {name}", true)
        assert distance(other) == pytest.approx(factor * distance(true))
        assert angle_deg(other[0], other[-1]) == pytest.approx(angle_deg(true[0], true[-1]))
    swapped = told("direction of poses swapped", true)
    for one, wrong in zip(true, swapped, strict=True):
        np.testing.assert_allclose(wrong.world_from_cam @ one.world_from_cam, np.eye(4), atol=1e-12)
    for factor, name in ((1.03, "focal lengths 3 % too long"), (1.1, "1.1 times")):
        name = next(n for n in EVERY if name in n and not n.startswith("last"))
        assert told(name, true)[1].k[0, 0] == pytest.approx(factor * K[0, 0])
        assert told(name, true)[1].k[1, 1] == pytest.approx(factor * K[1, 1])
    off = told("last principal point off by 10 px", true)[-1].k - K
    assert np.linalg.norm(off) == pytest.approx(np.linalg.norm(off[:2, 2])) == pytest.approx(10)
    exchanged = told("red and blue exchanged", true)
    assert all((e.image == t.image[:, :, ::-1]).all() for e, t in zip(exchanged, true, strict=True))
    assert (told("last image mirrored", true)[-1].image == last.image[:, ::-1]).all()
    assert (told("last image upside down", true)[-1].image == last.image[::-1, ::-1]).all()
    half = told("images of half the size", true)[0]
    assert half.image.shape == (30, 40, 3) and shots.rig_of([half]).cameras[0].size == (40, 30)
    # All but the last camera are as they were.
    for name in EVERY:
        if name.startswith("last "):
            assert told(name, true)[0] is true[0] and told(name, true)[1] is true[1]


def test_a_true_group_is_told_as_it_is(three):
    rig = shots.rig_of(EVERY["none"][1](shots.of_group(three), None))
    assert rig == three.rig


def test_the_fisheye_image_shows_what_the_pinhole_image_shows():
    """A bright spot 20 degrees off the axis."""
    k = np.array([[300.0, 0, 160], [0, 300, 120], [0, 0, 1]])
    image = np.zeros((240, 320, 3), np.uint8)
    column = 160 + 300 * np.tan(np.deg2rad(20))
    image[118:123, int(column) - 2 : int(column) + 3] = 255
    shot = shots.through_fisheye(shots.Shot("a", k, np.eye(4), image))
    _, columns = np.nonzero(shot.image[:, :, 0] > 128)
    assert columns.mean() == pytest.approx(160 + 300 * np.deg2rad(20), abs=1.0)


def named(group: groups.Group, foreign=None, kinds=tellings.DEFAULT) -> list[tuple[str, str]]:
    rng = np.random.default_rng(0)
    found = tellings.tellings(shots.of_group(group), kinds, rng, foreign)
    return [(one.name, one.variant) for one in found]


def test_wrong_orders_are_all_of_few_images_and_some_of_many():
    rng = np.random.default_rng(0)
    assert tellings.orders(2, rng) == [(1, 0)]
    assert len(tellings.orders(3, rng)) == len(set(tellings.orders(3, rng)) - {(0, 1, 2)}) == 5
    for views in (4, 11):
        found = tellings.orders(views, rng)
        assert len(set(found)) == 6 and tuple(range(views)) not in found
        assert all(sorted(order) == list(range(views)) for order in found)


def test_each_group_is_told_what_can_be_told_of_it(three):
    orders = [variant for name, variant in named(three) if name == tellings.ORDER]
    assert orders == ["0 2 1", "1 0 2", "1 2 0", "2 0 1", "2 1 0"]
    names = [name for name, _ in named(three, kinds=("gross",))]
    assert (
        tellings.REPEATED in names
        and tellings.REPEATED_LAST in names
        and tellings.FOREIGN not in names
    )
    pair = [name for name, _ in named(made(2), foreign=lambda: None)]
    assert (
        pair.count(tellings.ORDER) == 1
        and tellings.FOREIGN in pair
        and tellings.REPEATED_LAST not in pair
    )
    # Only images of ideal pinhole cameras can be bent to those of another lens.
    assert any("equidistant" in name for name, _ in named(three, kinds=("more",)))
    lens = mvtop.Camera(K, SIZE, model="fisheye", distortion=[0.0] * 4, id="c0")
    bent = groups.Group("0", "0", mvtop.Rig([lens]), {"c0": None}, (), frozenset())
    assert not any("equidistant" in name for name, _ in named(bent, kinds=("more",)))


def estimate(pose: np.ndarray, confidence: float | None = 0.95, obj: ObjectClass = NUT):
    sigma = SimpleNamespace(rot_deg=2.0, t_m=0.001)
    return SimpleNamespace(
        class_name=obj.name, world_from_obj=pose, confidence=confidence, sigma=sigma,
        boxes={"c0": None},
    )  # fmt: skip


def as_first_image_shows(group: groups.Group, said: shots.Shots) -> np.ndarray:
    """The true pose in the world of what was said, by the camera that took the first image."""
    taken_by = next(c for c in group.rig.cameras if c.id == said[0].taken_by)
    cam_from_obj = np.linalg.inv(taken_by.world_from_cam) @ group.truth[0].world_from_obj
    return said[0].world_from_cam @ cam_from_obj


def test_poses_are_judged_in_the_frame_of_the_camera_that_took_the_first_image(three):
    true = shots.of_group(three)
    rng = np.random.default_rng(0)
    for telling in tellings.tellings(
        true, tellings.LIES, rng, lambda: shots.of_group(made(2, 7))[-1]
    ):
        said = telling.change(true, rng)
        (one,) = lies.judged(three, said, [estimate(as_first_image_shows(three, said))])
        assert one["right"] and one["rot_err_deg"] < 1e-3 and one["t_err_mm"] < 1e-3, telling
    # An image of the wrong camera: what is true in the world is wrong in the image.
    (one,) = lies.judged(three, shots.ordered((1, 0, 2))(true, rng), [estimate(there())])
    assert not one["right"] and one["rot_err_deg"] == pytest.approx(20, rel=1e-3)
    # Of what is not there, no error can be told; of what is not asked for, nothing.
    (other,) = lies.judged(
        groups.Group("0", "0", three.rig, three.images, (), three.asked), true, [estimate(there())]
    )
    assert not other["right"] and other["rot_err_deg"] is None
    bolt = ObjectClass(2, "bolt", 0.1)
    assert lies.judged(three, true, [estimate(there(), obj=bolt)]) == []


def test_right_is_within_5_degrees_and_5_mm_of_the_nearest_true_object(three):
    true = shots.of_group(three)
    more = (*three.truth, groups.Truth(NUT, there(0.2), {}, counts=False))
    group = groups.Group("0", "0", three.rig, three.images, more, three.asked)
    found = [there(0.196), there(0.194), there(0.2) @ look(0, 4), there(0.2) @ look(0, 6)]
    judged = lies.judged(group, true, [estimate(pose) for pose in found])
    assert [one["right"] for one in judged] == [True, False, True, False]
    assert judged[1]["t_err_mm"] == pytest.approx(6) and judged[1]["seen_by"] == ["c0"]


def line(lie: str, group: int = 0, warnings=(), refused=None, poses=(), compared=(0, 0)) -> dict:
    kind = EVERY[lie][0] if lie in EVERY else "gross"
    return {
        "set": "s", "group": str(group), "scene": str(group), "views": 3, "kind": kind, "lie": lie,
        "variant": "", "refused": refused, "warnings": list(warnings),
        "confirmed": compared[0], "unconfirmed": compared[1],
        "poses": [{"right": right, "confidence": confidence} for right, confidence in poses],
    }  # fmt: skip


LINES = [
    line("none", 0, poses=[(True, 0.99), (False, 0.95)]),
    line("none", 1, warnings=["lines_miss"], compared=(6, 2)),
    line("OpenGL axes", 0, refused="no"),
    line(
        "OpenGL axes",
        1,
        warnings=["one_color"],
        poses=[(False, 0.99), (True, 0.2)],
        compared=(0, 3),
    ),
    line(
        "last image mirrored",
        0,
        compared=(1, 1),
        poses=[(False, 0.91), (False, 0.9), (False, 0.4), (True, 1.0)],
    ),
    line("translations 1 % too long", 0, poses=[(False, 0.7), (False, None)]),
]


def test_what_is_counted_worked_by_hand():
    told = noticed.summary(LINES)
    axes = told["lies"]["OpenGL axes"]
    assert (axes["groups"], axes["told"], axes["refused"], axes["noticed"]) == (2, 2, 1, 1.0)
    assert (axes["poses"], axes["wrong"], axes["doubted"], axes["sure_wrong"]) == (2, 1, 1.0, 0)
    assert axes["codes"] == {"one_color": 1}
    mirrored = told["lies"]["last image mirrored"]
    assert (mirrored["noticed"], mirrored["wrong"], mirrored["doubted"]) == (0, 3, 1 / 3)
    assert (mirrored["sure_wrong"], mirrored["sure_wrong_share"]) == (1, 0.25)
    assert told["kinds"]["none"]["noticed"] == 0.5
    assert told["kinds"]["gross"]["noticed"] == 2 / 3 and told["kinds"]["fine"]["noticed"] == 0
    # True groups are no lies.
    assert (told["all"]["told"], told["all"]["poses"], told["all"]["sure_wrong"]) == (4, 8, 1)
    rows = noticed.table(told).splitlines()
    assert rows[2] == "| none | 2 | 2 | 0 | 50 % | 2 | 1 | 0 % | 1 | 50.0 % |"
    assert rows[-1] == "| **all lies** | 2 | 4 | 1 | 50 % | 8 | 6 | 33 % | 1 | 12.5 % |"
    totals = noticed.totals(told)
    assert "12.50 % of 8 poses" in totals and "50.00 % of 2 true" in totals
    assert "other camera, none: 25.0 % of 8" in totals and "gross: 80.0 % of 5" in totals
    assert told["kinds"]["fine"]["unconfirmed"] is None


def test_bounds_that_are_not_kept_are_told():
    told = noticed.summary(LINES)

    def faults(**bounds) -> list[str]:
        return noticed.faults(told, bounds)

    assert faults(most_sure_wrong=0.125, most_false_alarms=0.5, least_noticed_gross=0.6) == []
    assert faults(most_sure_wrong=None, least_noticed_fine=0.0) == []
    (wrong,) = faults(most_sure_wrong=0.1)
    assert wrong == "--most-sure-wrong: expected 0.1 at most, got 0.1250"
    assert len(faults(most_false_alarms=0.4, least_noticed_gross=0.7, least_noticed_fine=0.1)) == 3
    told = noticed.summary(LINES[:2])  # of true groups alone
    assert "got none" in faults(most_sure_wrong=0.1)[0] and faults(most_false_alarms=1.0) == []
    told = noticed.summary(LINES[2:3])  # no pose is no wrong one
    assert faults(most_sure_wrong=0.0) == []


class Stopped(Exception):
    pass


@pytest.fixture
def run(monkeypatch, tmp_path):
    """Runs three made-up scenes with a made-up estimator, which stops at some prediction."""
    model = tmp_path / "model"
    model.mkdir()
    (model / "model.json").write_text(
        json.dumps({"classes": [{"id": 1, "name": "nut", "diameter_m": 0.1}]})
    )
    made_up = [made(3, n) for n in range(3)]
    planned = [groups.Planned(g.name, g.scene, lambda g=g: g) for g in made_up]
    monkeypatch.setattr(TestSet, "missing", lambda *_: None)
    monkeypatch.setattr(TestSet, "planned", lambda self, classes, limit: planned[:limit])

    def run(
        out: Path, stop: int | None = None, views: int = 3, **arguments
    ) -> tuple[list[dict], list]:
        seen = []

        class Estimator:
            def predict(self, images, rig, **options):
                if len(seen) == stop:
                    raise Stopped
                seen.append(images)
                if rig != made_up[0].rig:
                    raise mvtop.Error("made up")
                return SimpleNamespace(
                    objects=[estimate(there())], warnings=[], rig_consistency=None
                )

        monkeypatch.setattr(running, "loaded", lambda bundle, options: (Estimator(), {}))
        return lies.run(out, [TestSet("nuts", "", views, ())], model, **arguments), seen

    run.model, run.groups = model, made_up
    return run


def test_a_run_that_was_stopped_goes_on(run, tmp_path):
    out = tmp_path / "there/lies.jsonl"
    whole, seen = run(tmp_path / "whole.jsonl")
    assert len(seen) == len(whole) == 3 * 29
    with pytest.raises(Stopped):
        run(out, stop=40)
    with out.open("a") as file:
        file.write('{"set": "nu')  # a kill amid a line
    lines, seen = run(out, limit=2)
    assert len(lines) == 2 * 29 and len(seen) == 2 * 29 - 40
    lines, seen = run(out)
    assert len(seen) == 29 and lines == whole == lies.read(out)[1]
    assert run(out)[1] == []


def test_neither_limit_nor_kinds_change_what_is_drawn(run, tmp_path):
    _, every = run(tmp_path / "every.jsonl")
    _, fine = run(tmp_path / "fine.jsonl", limit=1, kinds=["gross"])
    for one, other in zip(every[1 : 1 + len(fine)], fine, strict=True):
        assert all((one[camera] == other[camera]).all() for camera in one)


def test_lines_tell_what_became_of_each_lie(run, tmp_path):
    lines, seen = run(tmp_path / "out.jsonl", limit=1)
    (true,) = (one for one in lines if one["lie"] == "none")
    assert true["refused"] is None and true["poses"][0]["right"] and true["kind"] == "none"
    (axes,) = (one for one in lines if one["lie"] == "OpenGL axes")
    assert (axes["refused"], axes["poses"]) == ("made up", [])
    swapped = next(one for one in lines if one["variant"] == "1 0 2")
    assert not swapped["poses"][0]["right"] and swapped["lie"] == tellings.ORDER
    (index,) = (n for n, one in enumerate(lines) if one["lie"] == tellings.FOREIGN)
    assert (seen[index]["c2"] == run.groups[1].images["c2"]).all()
    assert (seen[index]["c0"] == run.groups[0].images["c0"]).all()
    assert json.loads(json.dumps(lines)) == lines


def test_views_that_the_set_does_not_have_are_refused(run, tmp_path):
    with pytest.raises(UserError, match="nuts: expected groups of 2 images, got 3 of 0/0; fix"):
        run(tmp_path / "out.jsonl", views=2)


def test_lines_of_another_bundle_or_seed_are_not_gone_on_with(run, tmp_path):
    out = tmp_path / "out.jsonl"
    run(out, limit=1)
    with pytest.raises(UserError, match="expected lies of seed 1, got 0; fix"):
        run(out, seed=1)
    (run.model / "weights").write_text("other")
    with pytest.raises(UserError, match="expected lies of bundle"):
        run(out)
    (tmp_path / "other.jsonl").write_text('{"lie": "none"}\n')
    with pytest.raises(UserError, match="expected lies of format 1"):
        lies.read(tmp_path / "other.jsonl")


def test_sets_are_those_of_accuracy_or_folders(tmp_path):
    one = lies.set_of("path-ycb-3", None)
    assert one.disjoint and one.views == 3 and lies.set_of("path-ycb-3", 2).views == 2
    samples = lies.set_of(str(REPO / "examples/parts"), None)
    assert not samples.bop and samples.views == 0
    (tmp_path / "test").mkdir()
    folder = lies.set_of(str(tmp_path), None)
    assert folder.bop and folder.disjoint and folder.views == 2
    with pytest.raises(UserError, match="--set nothing: expected a folder or a set"):
        lies.set_of("nothing", None)


def shown(monkeypatch, capsys, *arguments) -> tuple[str, str | int]:
    """What the command prints, and what it exits with."""
    monkeypatch.setattr("sys.argv", ["lies", *map(str, arguments)])
    code = 0
    try:
        lies.main()
    except SystemExit as end:
        code = end.code
    return capsys.readouterr().out, code


def test_show_fails_where_a_bound_is_not_kept(monkeypatch, capsys, tmp_path):
    path = tmp_path / "lies.jsonl"
    path.write_text("".join(json.dumps(one) + "\n" for one in [{"format": 1}, *LINES]))
    out, code = shown(monkeypatch, capsys, "show", path)
    assert code == 0 and "**all gross**" in out
    out, code = shown(monkeypatch, capsys, "show", path, "--json")
    assert json.loads(out)["sets"]["s, 3 views"]["all"]["poses"] == 8
    bounds = ("--most-sure-wrong", "0.01", "--least-noticed-fine", "0.5")
    out, code = shown(monkeypatch, capsys, "show", path, "--fail", *bounds)
    assert "**all lies**" in out and len(code.splitlines()) == 2
    assert all(sentence.startswith("error: --") for sentence in code.splitlines())
    assert shown(monkeypatch, capsys, "show", path, "--fail", "--most-sure-wrong", "1")[1] == 0
    for arguments in (("--fail",), bounds):
        assert "together with bounds" in shown(monkeypatch, capsys, "show", path, *arguments)[1]


def test_wrong_calibrations_of_the_example_are_noticed(tmp_path):
    """One pair: the lies that leave no room for a pose that fits."""
    out = tmp_path / "lies.jsonl"
    example = lies.set_of(str(REPO / "examples/mvball"), None)
    lines = lies.run(out, [example], REPO / "models/mvball", kinds=list(tellings.LIES))
    names = {line["lie"] for line in lines if line["refused"] or line["warnings"]}
    assert "none" not in names
    assert names >= {
        "last camera rolled by 90 degrees", "translations 1000 times too long",
        "translations 1000 times too short", "direction swapped, first camera as world",
        "rotations transposed, first camera as world", "OpenGL axes",
        "order of quaternions, first camera as world", "focal lengths 1.5 times too long",
        "images of half the size", tellings.ORDER, "last image upside down",
    }  # fmt: skip
    (true,) = (line for line in lines if line["lie"] == "none")
    assert [pose["class"] for pose in true["poses"]] == ["mvball"]
    told = noticed.summary(lines)
    assert told["lies"]["translations 1000 times too long"]["refused"] == 1
    assert noticed.table(told).count("\n") == 2 + len(told["lies"]) + 3 + 1


def test_wrong_images_and_calibrations_of_several_objects_are_noticed(tmp_path):
    """Four objects in three views: every gross lie, and no pose that is wrong, sure and silent."""
    example = lies.set_of(str(REPO / "examples/ycbv4"), None)
    kinds = [tellings.TRUE, "gross"]
    told = noticed.summary(
        lies.run(tmp_path / "lies.jsonl", [example], REPO / "models/ycbv4", kinds=kinds)
    )
    assert told["kinds"][tellings.TRUE]["noticed"] == 0
    assert told["kinds"]["gross"]["noticed"] == 1 and told["kinds"]["gross"]["told"] == 15
    assert told["all"]["sure_wrong"] == 0

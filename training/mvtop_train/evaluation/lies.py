"""Wrong calibrations and wrong images: how many are noticed, and what poses come of the others.

    python -m mvtop_train.evaluation.lies run --model models/ycbv4 --set path-ycb-3 \\
        --out out/lies.jsonl
    python -m mvtop_train.evaluation.lies show out/lies.jsonl --json

`run` tells each kind of lie about each group of a set, and predicts. A set is one of
`evaluation/sets.py`, a data set in BOP's layout, or a folder of samples; groups share no image. A
lie is noticed where rig or images are refused, or poses warned of; of true groups (`none`) that is
a false alarm. A pose is right within 5 degrees and 5 mm of a true object of its class, in the frame
of the camera that took the first image. `--out` has a line for each group and lie; a run that was
stopped goes on there. Needs mvtop's wheel (`make wheel`).
"""

import argparse
import datetime
import itertools
import json
import math
import zlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from tqdm import tqdm

from ..errors import UserError, argument_parser, asking_mvtop, command
from ..files import read_text
from . import running, shots
from .groups import Group, Planned, classes_of
from .outcomes import WITHIN_DEG, WITHIN_M, errors
from .sets import TestSet, fixed
from .shots import Lie, Shot, Shots, of_all, of_last, placed, relative

FORMAT = 1
ORDERS = 6  # wrong orders of images that are told of a group, at most
SURE, UNSURE = 0.9, 0.5  # confidence above and below
DIGITS = 6  # of numbers in lines
TRUE = "none"
DEFAULT = (TRUE, "gross", "fine")

# By kind and name. Wrong orders and foreign images depend on the group: `tellings`.
ORDER, REPEATED, REPEATED_LAST = "wrong order of images", "first image for all", "first for last"
FOREIGN = "last image of another scene"
LIES: dict[str, dict[str, Lie]] = {
    TRUE: {"none": lambda shots, rng: shots},
    "gross": {
        "last image mirrored": of_last(shots.mirrored),
        "last image upside down": of_last(shots.upside_down),
        "red and blue exchanged": of_all(shots.red_as_blue),
        "last camera rolled by 90 degrees": shots.rolled(90),
        "direction of poses swapped": placed(np.linalg.inv),
        "OpenGL axes": placed(shots.opengl),
        "rotations transposed": placed(shots.transposed),
        "order of quaternions": placed(shots.quaternion_misread),
    },
    "fine": {
        "translations 1 % too long": shots.scaled(1.01),
        "translations 2 % too long": shots.scaled(1.02),
        "translations 5 % too long": shots.scaled(1.05),
        "translations 2 % too short": shots.scaled(0.98),
        "translations 5 % too short": shots.scaled(0.95),
        "last camera turned by 1 degree": shots.turned(1),
        "last camera turned by 2 degrees": shots.turned(2),
        "last camera moved by 10 mm": shots.moved(0.01),
        "last camera moved by 20 mm": shots.moved(0.02),
        "focal lengths 3 % too long": of_all(shots.focal(1.03)),
        "last focal length 3 % too long": of_last(lambda s, rng: shots.focal(1.03)(s)),
        "last principal point off by 10 px": shots.principal_point(10),
    },
    "more": {  # which docs/warnings.md had before
        "last camera turned by 5 degrees": shots.turned(5),
        "last camera moved by 50 mm": shots.moved(0.05),
        "last camera rolled by 10 degrees": shots.rolled(10),
        "translations 10 % too long": shots.scaled(1.1),
        "translations 1000 times too long": shots.scaled(1000),
        "translations 1000 times too short": shots.scaled(1e-3),
        "direction swapped, first camera as world": relative(np.linalg.inv),
        "rotations transposed, first camera as world": relative(shots.transposed),
        "order of quaternions, first camera as world": relative(shots.quaternion_misread),
        "focal lengths 1.1 times too long": of_all(shots.focal(1.1)),
        "focal lengths 1.5 times too long": of_all(shots.focal(1.5)),
        "last focal length 1.1 times too long": of_last(lambda s, rng: shots.focal(1.1)(s)),
        "last principal point off by 30 px": shots.principal_point(30),
        "images of half the size": of_all(shots.halved),
        "equidistant read as pinhole": shots.fisheye_read_as("pinhole", ()),
        "equidistant read as radtan": shots.fisheye_read_as(
            "pinhole", (0.05, -0.02, 0.01, -0.005)
        ),
    },
}  # fmt: skip


@dataclass(frozen=True)
class Telling:
    """A lie about one group."""

    kind: str
    name: str
    change: Lie
    variant: str = ""  # of lies that are told of a group several times


def generator(seed: int, *names: str) -> np.random.Generator:
    """Of its own for each, so that neither limit nor order of groups changes what another draws."""
    return np.random.default_rng([seed, zlib.crc32("\0".join(names).encode())])


def orders(views: int, rng: np.random.Generator) -> list[tuple[int, ...]]:
    """The wrong orders of images; of more than three so many at random."""
    right = tuple(range(views))
    if math.factorial(views) - 1 <= ORDERS:
        return [order for order in itertools.permutations(right) if order != right]
    found: dict[tuple[int, ...], None] = {}
    while len(found) < ORDERS:
        order = tuple(rng.permutation(views).tolist())
        if order != right:
            found[order] = None
    return list(found)


def tellings(
    true: Shots,
    kinds: Iterable[str],
    rng: np.random.Generator,
    foreign: Callable[[], Shot] | None,
) -> list[Telling]:
    """The lies that can be told of a group.

    - rng: draws orders
    - foreign: gives the last camera of another scene; None: there is no other
    """
    views, found = len(true), []
    for kind in kinds:
        if kind == "gross":
            for order in orders(views, rng):
                name = " ".join(map(str, order))
                found.append(Telling(kind, ORDER, shots.ordered(order), name))
            found.append(Telling(kind, REPEATED, shots.ordered((0,) * views)))
            if views > 2:  # of two that is the same
                last = (*range(views - 1), 0)
                found.append(Telling(kind, REPEATED_LAST, shots.ordered(last)))
            if foreign is not None:
                change = of_last(lambda s, rng: replace(s, image=foreign().image, taken_by=None))
                found.append(Telling(kind, FOREIGN, change))
        ideal = all(shot.model == "pinhole" and not shot.distortion for shot in true)
        for name, lie in LIES[kind].items():
            if ideal or not name.startswith("equidistant"):
                found.append(Telling(kind, name, lie))
    return found


def _rounded(x: float | None) -> float | None:
    return None if x is None else float(f"{x:.{DIGITS}g}")


def judged(group: Group, told: Shots, found: list) -> list[dict]:
    """Each estimate against the nearest true object of its class, in the first camera's frame.

    That is the frame of the camera that took the first image. What the other images show, and where
    the other cameras are said to stand, is no part of the truth: it may be the lie.

    - found: estimates with `world_from_obj` [4, 4] in the world of what was told, m
    - returns: of each its class, `seen_by` (ids of cameras with a box), whether it is right, errors
      (None where the class is not there), confidence, and expected errors
    """
    by_id = {camera.id: camera for camera in group.rig.cameras}
    cam_from_world = np.linalg.inv(by_id[told[0].taken_by].world_from_cam)
    told_cam_from_world = np.linalg.inv(told[0].world_from_cam)
    lines = []
    for one in found:
        if one.class_name not in group.asked:
            continue
        pose = told_cam_from_world @ one.world_from_obj
        off = [
            errors(cam_from_world @ there.world_from_obj, pose, there.known)
            for there in group.truth
            if there.known.name == one.class_name
        ]
        rot_deg, t_m = min(off, key=lambda pair: pair[1], default=(None, None))
        right = rot_deg is not None and rot_deg <= WITHIN_DEG and t_m <= WITHIN_M
        lines.append({
            "class": one.class_name,
            "seen_by": list(one.boxes),
            "right": right,
            "rot_err_deg": _rounded(rot_deg),
            "t_err_mm": None if t_m is None else _rounded(1e3 * t_m),
            "confidence": _rounded(one.confidence),
            "sigma_rot_deg": _rounded(one.sigma.rot_deg),
            "sigma_t_mm": _rounded(1e3 * one.sigma.t_m),
        })  # fmt: skip
    return lines


def answer(estimator, options: dict, group: Group, told: Shots, trust_unit: bool = False) -> dict:
    """What becomes of what was told: `refused`, or `warnings` (codes) and judged `poses`.

    - options: of predict
    """
    import mvtop  # loads its compiled part

    try:
        rig = shots.rig_of(told, trust_unit)
        prediction = estimator.predict({shot.id: shot.image for shot in told}, rig, **options)
    except TypeError as error:  # an option that it does not have
        raise UserError(f"--option: {error}; fix: leave it out") from None
    except (mvtop.Error, ValueError) as error:
        return {"refused": str(error), "warnings": [], "poses": []}
    fit = prediction.rig_consistency
    return {
        "refused": None,
        "warnings": sorted({warning.code for warning in prediction.warnings}),
        "px": None if fit is None else _rounded(fit.px),
        "deviation": None if fit is None else _rounded(fit.deviation),
        "poses": judged(group, told, prediction.objects),
    }


def _trusted(true: Shots) -> bool:
    """Whether the true cameras stand as near or far as is taken for another unit than metres."""
    try:
        shots.rig_of(true)
    except ValueError:
        return True
    return False


def set_of(name: str, views: int | None) -> TestSet:
    """A fixed set by name, or that of a folder; groups share no image.

    - views: of a group; None: as the set has it; of folders in BOP's layout 2, of samples any (0)
    """
    sets = fixed()
    if name in sets:
        one = replace(sets[name], disjoint=True)
    elif Path(name).is_dir():
        root = Path(name)
        bop = (root / "test").is_dir()
        one = TestSet(name, "", 2 if bop else 0, (root,), bop=bop, disjoint=True)
    else:
        known = ", ".join(sets)
        raise UserError(
            f"--set {name}: expected a folder or a set, got neither; fix: a folder, or one of "
            f"{known}"
        )
    return one if views is None else replace(one, views=views)


def header(model: Path, seed: int, options: dict) -> dict:
    """What a file of lines is of."""
    with asking_mvtop("make wheel"):
        import mvtop

        build = running.digest(Path(mvtop.__file__).parent, "_mvtop*.so")
    return {
        "format": FORMAT,
        "model": str(model),
        "bundle": running.digest(model),
        "build": build,
        "seed": seed,
        "options": options,
        "commit": running.commit(),
        "date": datetime.datetime.now().astimezone().isoformat(timespec="seconds"),
    }


def read(path: Path) -> tuple[dict, list[dict]]:
    """The header of a file, and its lines; one that a kill left unfinished is none."""
    fix = "python -m mvtop_train.evaluation.lies run --out FILE"
    text = read_text(path, fix)
    whole = text[: text.rfind("\n") + 1].splitlines()
    try:
        lines = [json.loads(line) for line in whole]
    except ValueError as error:
        raise UserError(f"{path}: expected JSON Lines, got: {error}; fix: {fix}") from None
    if not lines or not isinstance(lines[0], dict) or lines[0].get("format") != FORMAT:
        raise UserError(f"{path}: expected lies of format {FORMAT}, got another file; fix: {fix}")
    return lines[0], lines[1:]


def _begun(out: Path, about: dict) -> list[dict]:
    """The lines to go on with; those of another model, build, seed or option are refused."""
    if not out.exists():
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(json.dumps(about) + "\n")
        return []
    before, lines = read(out)
    for key in ("bundle", "build", "seed", "options"):
        if before[key] != about[key]:
            raise UserError(
                f"{out}: expected lies of {key} {about[key]!r}, got {before[key]!r}; "
                "fix: another --out, or delete it"
            )
    # What a kill has left of a line goes.
    out.write_text("".join(json.dumps(line) + "\n" for line in [before, *lines]))
    return lines


def run(
    out: Path,
    sets: list[TestSet],
    model: Path,
    kinds: Iterable[str] = DEFAULT,
    limit: int | None = None,
    seed: int = 0,
    options: dict | None = None,
) -> list[dict]:
    """What becomes of every lie about every group of these sets; goes on where `out` ends.

    - kinds: of lies, keys of LIES
    - limit: groups of each set, at most
    """
    options = options or {}
    classes = classes_of(model)
    lines = _begun(out, header(model, seed, options))
    estimator, predicting = running.loaded(model, options)
    ask = partial(answer, estimator, predicting)
    with out.open("a") as file:
        for one in sets:
            if (why := one.missing(limit)) is not None:
                raise UserError(f"{why}; fix: another --set")
            planned = one.planned(classes, None)
            known = {_key(line) for line in lines}
            for number, plan in enumerate(tqdm(planned[:limit], unit="group", desc=one.name)):
                other = _of_another_scene(planned, number)
                for line in _told(one, plan, other, kinds, seed, known, ask):
                    lines.append(line)
                    file.write(json.dumps(line) + "\n")
                    file.flush()
    return lines


def _key(line: dict) -> tuple:
    return tuple(line[key] for key in ("set", "views", "group", "lie", "variant"))


def _of_another_scene(planned: list[Planned], number: int) -> Planned | None:
    """The next group of another scene, from the first again after the last."""
    after = [*planned[number + 1 :], *planned[:number]]
    return next((plan for plan in after if plan.scene != planned[number].scene), None)


def _told(
    one: TestSet,
    plan: Planned,
    other: Planned | None,
    kinds: Iterable[str],
    seed: int,
    known: set[tuple],
    ask: Callable[[Group, Shots, bool], dict],
) -> Iterator[dict]:
    """A line for each lie about a group that is not known yet.

    - other: of another scene
    - known: keys of lines
    - ask: gives the `answer`
    """
    group = plan.load()
    true = shots.of_group(group)
    if len(true) < 2:
        raise UserError(
            f"{one.name}: expected groups of two images or more, got one of {plan.name}; "
            "fix: another --set, or --views 2"
        )
    if one.views not in (0, len(true)):
        raise UserError(
            f"{one.name}: expected groups of {one.views} images, got {len(true)} of {plan.name}; "
            "fix: leave out --views"
        )

    def foreign() -> Shot:
        return shots.of_group(other.load())[-1]

    trust_unit = _trusted(true)
    draws = generator(seed, one.name, plan.name, "orders")
    for telling in tellings(true, kinds, draws, None if other is None else foreign):
        about = {
            "set": one.name, "group": plan.name, "scene": plan.scene, "views": len(true),
            "kind": telling.kind, "lie": telling.name, "variant": telling.variant,
        }  # fmt: skip
        if _key(about) not in known:
            rng = generator(seed, one.name, plan.name, telling.name, telling.variant)
            told = telling.change(true, rng)
            yield about | ask(group, told, trust_unit)


def counts(lines: list[dict]) -> dict:
    """What some lies amount to; of poses that are wrong, how many are doubted, and how many sure:
    not warned of, and of a confidence above 0.9."""
    poses = [(pose, bool(line["warnings"])) for line in lines for pose in line["poses"]]
    wrong = [(pose["confidence"], warned) for pose, warned in poses if not pose["right"]]
    doubted = [warned or (sure is not None and sure < UNSURE) for sure, warned in wrong]
    sure = [not warned and sure is not None and sure > SURE for sure, warned in wrong]
    codes = sorted({code for line in lines for code in line["warnings"]})
    return {
        "groups": len({_key(line)[:3] for line in lines}),
        "told": len(lines),
        "refused": sum(line["refused"] is not None for line in lines),
        "codes": {code: sum(code in line["warnings"] for line in lines) for code in codes},
        "noticed": _share(sum(bool(line["refused"] or line["warnings"]) for line in lines), lines),
        "poses": len(poses),
        "wrong": len(wrong),
        "doubted": _share(sum(doubted), wrong),
        "sure_wrong": sum(sure),
        "sure_wrong_share": _share(sum(sure), poses),
    }


def _share(count: int, of: list) -> float | None:
    return count / len(of) if of else None


def summary(lines: list[dict]) -> dict:
    """`lies` by name, each with its kind; `kinds`; and `all` lies, true groups left out."""
    names = dict.fromkeys((line["kind"], line["lie"]) for line in lines)
    places = {kind: place for place, kind in enumerate(LIES)}
    names = sorted(names, key=lambda pair: places[pair[0]])

    def of(**wanted: str) -> dict:
        return counts([x for x in lines if all(x[k] == v for k, v in wanted.items())])

    return {
        "lies": {name: {"kind": kind} | of(kind=kind, lie=name) for kind, name in names},
        "kinds": {kind: of(kind=kind) for kind in dict.fromkeys(kind for kind, _ in names)},
        "all": counts([line for line in lines if line["kind"] != TRUE]),
    }


HEAD = ["", "groups", "told", "refused", "noticed", "poses", "wrong", "of these doubted"]
HEAD += ["wrong and sure", "of all poses"]


def table(told: dict) -> str:
    """Markdown of a summary."""

    def percent(share: float | None, digits: int = 0) -> str:
        return "–" if share is None else f"{100 * share:.{digits}f} %"

    def row(name: str, one: dict) -> list:
        return [
            name, one["groups"], one["told"], one["refused"], percent(one["noticed"]), one["poses"],
            one["wrong"], percent(one["doubted"]), one["sure_wrong"],
            percent(one["sure_wrong_share"], 1),
        ]  # fmt: skip

    rows = [HEAD, ["---"] * len(HEAD)]
    for kind, whole in told["kinds"].items():
        rows += [row(name, one) for name, one in told["lies"].items() if one["kind"] == kind]
        if kind != TRUE:
            rows.append(row(f"**all {kind}**", whole))
    if told["all"]["told"]:
        rows.append(row("**all lies**", told["all"]))
    return "".join("| " + " | ".join(str(cell) for cell in row) + " |\n" for row in rows)


def totals(told: dict) -> str:
    """The two figures that count most, in a line each."""
    every, true = told["all"], told["kinds"].get(TRUE)
    text = ""
    if every["poses"]:
        share = 100 * every["sure_wrong_share"]
        text += f"wrong, not warned of, above {SURE}: {share:.2f} % of {every['poses']} poses "
        text += "under lies\n"
    if true:
        text += f"false alarms: {100 * true['noticed']:.2f} % of {true['told']} true groups\n"
    return text


def faults(told: dict, bounds: dict[str, float | None]) -> list[str]:
    """A sentence for each bound that is not kept.

    - bounds: shares by name, as the options have them; None: not asked for
    """
    kinds, every = told["kinds"], told["all"]
    values = {
        "most_sure_wrong": (every["sure_wrong_share"] or 0.0) if every["told"] else None,
        "most_false_alarms": kinds[TRUE]["noticed"] if TRUE in kinds else None,
        "least_noticed_gross": kinds["gross"]["noticed"] if "gross" in kinds else None,
        "least_noticed_fine": kinds["fine"]["noticed"] if "fine" in kinds else None,
    }
    sentences = []
    for name, bound in bounds.items():
        value, most = values[name], name.startswith("most")
        if bound is None:
            continue
        option = f"--{name.replace('_', '-')}"
        if value is None:
            sentences.append(f"{option}: expected what it is of, got none; fix: run it with --kind")
        elif value > bound if most else value < bound:
            word = "most" if most else "least"
            sentences.append(f"{option}: expected {bound:g} at {word}, got {value:.4f}")
    return sentences


BOUNDS = {
    "most_sure_wrong": "of poses under lies that are wrong, not warned of, above 0.9",
    "most_false_alarms": "of true groups that are refused or warned of",
    "least_noticed_gross": "of gross lies that are noticed",
    "least_noticed_fine": "of fine lies that are noticed",
}


def arguments() -> argparse.ArgumentParser:
    parser = argument_parser(__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    asked = commands.add_parser("run", help="tell lies, and write what became of them")
    add = asked.add_argument
    add("--model", type=Path, required=True, metavar="DIR", help="bundle")
    add("--set", action="append", required=True, metavar="SET", help="name or folder; repeatable")
    add("--views", type=int, metavar="N", help="of a group, in BOP's layout; as the set has, or 2")
    add("--kind", action="append", choices=list(LIES), help=f"repeatable; {', '.join(DEFAULT)}")
    add("--limit", type=int, metavar="N", help="groups of each set, at most")
    add("--seed", type=int, default=0, help="of what lies draw")
    add("--option", action="append", default=[], metavar="KEY=VALUE", help="as of accuracy run")
    add("--out", type=Path, required=True, help="file of JSON Lines; a stopped run goes on there")
    shown = commands.add_parser("show", help="the table of what was written")
    shown.add_argument("files", type=Path, nargs="+")
    for one in (asked, shown):
        one.add_argument("--json", action="store_true", help="print JSON instead of tables")
        one.add_argument("--fail", action="store_true", help="exit 1 where a bound is not kept")
        for name, what in BOUNDS.items():
            option = f"--{name.replace('_', '-')}"
            one.add_argument(option, type=float, metavar="SHARE", help=f"0 to 1, {what}")
    return parser


@command
def main():
    args = arguments().parse_args()
    bounds = {name: getattr(args, name) for name in BOUNDS}
    if args.fail != any(bound is not None for bound in bounds.values()):
        options = ", ".join(f"--{name.replace('_', '-')}" for name in BOUNDS)
        raise UserError(f"--fail: expected it together with bounds, got one alone; fix: {options}")
    if args.command == "run":
        for name, least in (("limit", 1), ("views", 2), ("seed", 0)):
            value = getattr(args, name)
            if value is not None and value < least:
                raise UserError(f"--{name}: expected at least {least}, got {value}; fix: {least}")
        sets = [set_of(name, args.views) for name in dict.fromkeys(args.set)]
        kinds = [kind for kind in LIES if kind in (args.kind or DEFAULT)]
        options = running.options_of(args.option)
        lines = run(args.out, sets, args.model, kinds, args.limit, args.seed, options)
    else:
        lines = [line for path in args.files for line in read(path)[1]]
    if not lines:
        raise UserError("expected lies that were told, got none; fix: --set, --kind")
    told = summary(lines)
    if args.json:
        by_set: dict[str, list[dict]] = {}
        for line in lines:
            by_set.setdefault(f"{line['set']}, {line['views']} views", []).append(line)
        sets = {name: summary(of_set) for name, of_set in by_set.items()}
        print(json.dumps(told | {"sets": sets}))
    else:
        print(table(told) + "\n" + totals(told), end="")
    if args.fail and (sentences := faults(told, bounds)):
        raise UserError("\nerror: ".join(sentences))


if __name__ == "__main__":
    main()

"""Wrong calibrations and wrong images: how many are noticed, and what poses come of the others.

    mvtop-train lies run --model models/ycbv4 --set path-ycb-3 \\
        --out out/lies.jsonl
    mvtop-train lies show out/lies.jsonl --json

`run` tells each kind of lie about each group of a set, and predicts. A set is one of
`evaluation/sets.py`, a data set in BOP's layout, or a folder of samples; groups share no image. A
lie is noticed where rig or images are refused, or poses warned of; of true groups (`none`) that is
a false alarm. A pose is right within 5 degrees and 5 mm of a true object of its class, in the frame
of the camera that took the first image. `--out` has a line for each group and lie; a run that was
stopped goes on there. Needs mvtop's wheel (`make wheel`).
"""

import argparse
import datetime
import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from tqdm import tqdm

from ..errors import UserError, argument_parser, asking_mvtop, command
from ..files import read_text
from . import running, shots
from .groups import Group, Planned, classes_of
from .noticed import faults, key_of, summary, table, totals
from .outcomes import WITHIN_DEG, WITHIN_M, errors
from .sets import TestSet, fixed
from .shots import Shot, Shots
from .tellings import DEFAULT, LIES, generator, tellings

FORMAT = 1
DIGITS = 6  # of numbers in lines


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
        "confirmed": 0 if fit is None else fit.confirmed,
        "unconfirmed": 0 if fit is None else fit.unconfirmed,
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
    fix = "mvtop-train lies run --out FILE"
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
            known = {key_of(line) for line in lines}
            for number, plan in enumerate(tqdm(planned[:limit], unit="group", desc=one.name)):
                other = _of_another_scene(planned, number)
                for line in _told(one, plan, other, kinds, seed, known, ask):
                    lines.append(line)
                    file.write(json.dumps(line) + "\n")
                    file.flush()
    return lines


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
        if key_of(about) not in known:
            rng = generator(seed, one.name, plan.name, telling.name, telling.variant)
            told = telling.change(true, rng)
            yield about | ask(group, told, trust_unit)


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
        raise UserError(*sentences)


if __name__ == "__main__":
    main()

"""The config that one's own parts stand for, of which nothing but meshes and a rig is known: they
are learnt as the config `parts` says, from the weights of `models/parts`."""

from pathlib import Path

from .. import shipped
from ..data import rig
from . import runconfig

PARTS = shipped.FOLDER / "parts.toml"
SCENES_PER_MINUTE = 8  # of a whole run: two cores render them in a tenth of it
HELD_OUT, MOST_HELD_OUT = 5, 60  # one scene in so many; at most
REPORTED = 0.5, 20, 60  # scenes for the report: for each minute, at least, at most
# Of the export; of what is chosen and of the report, for each scene of so many parts and views.
END_MINUTES = 1.0, 0.06, 0.05
END_PARTS, END_VIEWS = 12, 4
MOST_END = 0.5  # of the minutes: of many parts or cameras fewer scenes are held out,
LEAST_SCENES = 8  # but so many of each kind


def config(
    out: Path, minutes: float, generate: dict, backgrounds: str, changes: list[str] = ()
) -> runconfig.RunConfig:
    """A run that was begun keeps its scenes, however many minutes it is given now."""
    kept, instances = runconfig.begun(out), generate["instances"]
    work = work_of(len(generate["mesh"]) * instances, generate["rig"])
    if kept is None:
        count = round(min(max(SCENES_PER_MINUTE * minutes, 60), 1300))
        held_out, test = scenes_of(minutes, count, work)
        scenes = {"scenes": count, "start": count, "test": test}
    else:
        held_out = kept.held_out
        scenes = kept.generate.model_dump(include={"scenes", "start", "test"})
    reserve = end_minutes(held_out, scenes["test"], work)
    parts = runconfig.load(PARTS)
    fields = parts.model_dump(exclude_unset=True) | {
        "data": str(out / "data"), "minutes": minutes, "init": str(shipped.START),
        "copies": max(parts.copies, 6 // max(instances, 1)), "backgrounds": backgrounds,
        "held_out": held_out,
        # All are rendered before features are kept of them: a tenth of the time for each.
        "generate": {**generate, **scenes, "views": parts.generate.views, "reserve": reserve},
    }  # fmt: skip
    return runconfig.validated("options", fields, changes)


def scenes_of(minutes: float, count: int, work: float) -> tuple[int, int]:
    """How many of `count` scenes are held out, and how many are for the report."""
    each, least, most = REPORTED
    held_out = min(count // HELD_OUT, MOST_HELD_OUT)
    test = round(min(max(each * minutes, least), most))
    export = END_MINUTES[0]
    share = (MOST_END * minutes - export) / (end_minutes(held_out, test, work) - export)
    if share >= 1:
        return held_out, test
    return max(int(share * held_out), LEAST_SCENES), max(int(share * test), LEAST_SCENES)


def work_of(parts: int, rigs: tuple[str, ...]) -> float:
    """What a scene takes, by that of `END_PARTS` in `END_VIEWS`. Half of it is reckoned to be for
    its images, however many parts they show."""
    views = max((len(rig.load(Path(path))) for path in rigs), default=END_VIEWS)
    return views / END_VIEWS * (1 + parts / END_PARTS) / 2


def end_minutes(held_out: int, test: int, work: float) -> float:
    """What is kept for what follows the training."""
    export, choices, report = END_MINUTES
    return round(export + work * (choices * held_out + report * test), 2)

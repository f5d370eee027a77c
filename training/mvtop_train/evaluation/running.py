"""Runs test sets in this process, and keeps what came of them in one file, which a run that was
stopped goes on with."""

import contextlib
import datetime
import hashlib
import json
import os
import platform
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

from tqdm import tqdm

from .. import description
from ..errors import UserError, asking_mvtop
from ..files import read_json, write_text
from .groups import Group, classes_of
from .outcomes import outcome
from .sets import TestSet

FORMAT = 1
EVERY_S = 20.0  # the file is written


def machine() -> dict:
    """Processor, cores, system."""
    name = platform.processor()
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        names = (line.split(":")[1].strip() for line in lines if line.startswith("model name"))
        name = next(names, name)
    return {"processor": name, "cores": os.cpu_count(), "system": platform.platform()}


def commit() -> str | None:
    """Of the project's checkout, with `+` where files differ from it; None outside of one."""

    def git(*arguments: str) -> str:
        command = ["git", "-C", str(Path(__file__).parent), *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    try:
        changed = git("status", "--porcelain", "--untracked-files=no")
        return git("rev-parse", "HEAD") + ("+" if changed else "")
    except (OSError, subprocess.CalledProcessError):
        return None


def digest(folder: Path, pattern: str = "*") -> str:
    """Of the content of a folder's files."""
    total = hashlib.sha256()
    for path in sorted(folder.glob(pattern)):
        if path.is_file():
            total.update(path.name.encode() + b"\0" + hashlib.sha256(path.read_bytes()).digest())
    return total.hexdigest()[:16]


def text(results: dict) -> str:
    """JSON, a group a line, so that git shows what has changed."""
    lines = []
    for name, one in results["sets"].items():
        about = "".join(
            f"{json.dumps(key)}: {json.dumps(value)}, "
            for key, value in one.items()
            if key != "groups"
        )
        groups = ",\n".join(json.dumps(group) for group in one["groups"])
        lines.append(f'{json.dumps(name)}: {{{about}"groups": [\n{groups}\n]}}')
    head = {key: value for key, value in results.items() if key != "sets"}
    return json.dumps(head, indent=1)[:-2] + ',\n "sets": {\n' + ",\n".join(lines) + "\n}}\n"


def write(path: Path, results: dict):
    """So that a kill leaves the old file or the new one."""
    write_text(path, text(results))


def read(path: Path) -> dict:
    """What a run has written."""
    results = read_json(path, "mvtop-train accuracy run --out FILE")
    if not isinstance(results, dict) or results.get("format") != FORMAT:
        raise UserError(
            f"{path}: expected results of format {FORMAT}, got other JSON; "
            "fix: mvtop-train accuracy run --out FILE"
        )
    return results


def options_of(pairs: list[str]) -> dict:
    """KEY=VALUE as a dict; values are JSON, else text."""
    found = {}
    for pair in pairs:
        key, sign, value = pair.partition("=")
        if not sign:
            raise UserError(f"--option: expected KEY=VALUE, got {pair!r}; fix: refine=false")
        try:
            found[key] = json.loads(value)
        except ValueError:
            found[key] = value
    return found


def _part(options: dict, prefix: str) -> dict:
    return {k.removeprefix(prefix): v for k, v in options.items() if k.startswith(prefix)}


def loaded(bundle: Path, options: dict) -> tuple:
    """A bundle's estimator, and the options of its predictions.

    - options: `load.KEY` are of `mvtop.Estimator.load`, `bundle.KEY.KEY` replace what `model.json`
      says, others are of `predict`
    """
    with asking_mvtop("--model-... DIR, or another --option"), tempfile.TemporaryDirectory() as to:
        import mvtop  # loads its compiled part

        if changes := _part(options, "bundle."):
            bundle = _changed(bundle, changes, Path(to))
        try:
            estimator = mvtop.Estimator.load(bundle, **_part(options, "load."))
        except (mvtop.Error, TypeError) as error:
            raise UserError(f"{bundle}: {error}; fix: --model-... DIR, or --option") from None
    kept = {k: v for k, v in options.items() if not k.startswith(("load.", "bundle."))}
    return estimator, kept


def _changed(bundle: Path, changes: dict, folder: Path) -> Path:
    """A bundle with another `model.json`."""
    for path in bundle.iterdir():
        if path.name != description.NAME:
            shutil.copy(path, folder)  # links are refused
    about = description.read(bundle)
    for key, value in changes.items():
        *parents, last = key.split(".")
        place = about
        for parent in parents:
            place = place.get(parent) if isinstance(place, dict) else None
        if not isinstance(place, dict):
            raise UserError(
                f"--option bundle.{key}: expected a key of {bundle}/{description.NAME}, got none; "
                "fix: its name, such as bundle.detector.score_threshold"
            )
        place[last] = value
    description.write(folder, about)
    return folder


def begun(out: Path, options: dict) -> dict:
    """Results to go on with, or new ones.

    A file of another build of mvtop or of other options is refused.
    """
    with asking_mvtop("make wheel"):
        import mvtop

        build = digest(Path(mvtop.__file__).parent, "_mvtop*.so")
    told = {"build": build, "options": options}
    if not out.exists():
        return {
            "format": FORMAT,
            "machine": machine(),
            "date": datetime.datetime.now().astimezone().isoformat(timespec="seconds"),
            "commit": commit(),
            **told,
            "sets": {},
        }
    results = read(out)
    for key, value in told.items():
        if results[key] != value:
            what = "build of mvtop" if key == "build" else "--option"
            raise UserError(
                f"{out}: expected results of the same {what}, got {results[key]!r} instead of "
                f"{value!r}; fix: another --out, or delete it"
            )
    return results


def run(
    out: Path, sets: list[TestSet], models: dict[str, Path], limit: int | None, options: dict
) -> dict:
    """The results of these sets, one after the other; groups that `out` has are left as they are.

    - models: bundles by the name that sets ask for them by
    """
    results = begun(out, options)
    for one in sets:
        if one.model not in models:
            print(f"{one.name}: left out, as it needs --model-{one.model}")
        elif (why := one.missing(limit)) is not None:
            print(f"{one.name}: left out: {why}")
        else:
            _run(out, results, one, models[one.model], limit, options)
    if not results["sets"]:
        raise UserError("no set could be run: expected data and models; fix: --set, --model-...")
    return results


def _run(out: Path, results: dict, one: TestSet, model: Path, limit: int | None, options: dict):
    classes = classes_of(model)
    planned = one.planned(classes, limit)
    about = {"model": str(model), "bundle": digest(model), "views": one.views}
    kept = results["sets"].setdefault(one.name, {**about, "groups": []})
    if kept["bundle"] != about["bundle"]:
        raise UserError(
            f"{out}: expected results of {one.name} by the bundle that {model} is now, got another "
            "one's; fix: another --out, or delete it"
        )
    done = {group["group"] for group in kept["groups"]}
    left = [group for group in planned if group.name not in done]
    if not left:
        return
    estimator, predicting = loaded(model, options)
    written = time.monotonic()
    try:
        for plan in tqdm(left, unit="group", desc=one.name, initial=len(done), total=len(planned)):
            group = plan.load()
            kept["groups"].append(outcome(group, _predicted(estimator, group, predicting)))
            if time.monotonic() - written > EVERY_S:
                write(out, results)
                written = time.monotonic()
    finally:  # of a run that is stopped, what it has
        write(out, results)


def _predicted(estimator, group: Group, options: dict):
    """mvtop.Prediction, or the error that images or rig were refused with."""
    import mvtop  # loads its compiled part

    try:
        return estimator.predict(group.images, group.rig, **options)
    except TypeError as error:  # an option that it does not have
        raise UserError(f"--option: {error}; fix: leave it out") from None
    except (mvtop.Error, ValueError) as error:
        return error

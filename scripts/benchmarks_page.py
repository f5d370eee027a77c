"""Makes docs/benchmarks.md from the results in benches/results, for reference.py.

A file is a section: its title, the runs its figures are from, and its body: text, or tables of
columns and rows. Each run has a command, seed, machine and date; `null` is unknown.
"""

import json
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = "docs/benchmarks.md"
RESULTS = ROOT / "benches/results"
RUN = ("command", "seed", "machine", "date", "commit")
MISSING = "{}: a run needs {}, found {}; fix: add what is missing, null where unknown"


def run_line(run: dict, name: str) -> str:
    if set(run) != set(RUN):
        raise ValueError(MISSING.format(name, sorted(RUN), sorted(run)))
    told = {key: "?" if run[key] is None else str(run[key]) for key in RUN}
    command = told["command"] if run["command"] is None else f"`{told['command']}`"
    commit = "" if run["commit"] is None else f"; {told['commit']}"
    return f"- {command}; {told['seed']}; {told['machine']}; {told['date']}{commit}"


def table(block: dict) -> str:
    head, *rows = ("| " + " | ".join(cells) + " |" for cells in (block["columns"], *block["rows"]))
    rule = "|" + "---|" * len(block["columns"])
    return "\n".join([head, rule, *rows]).replace("|  |", "| |")


def section(path: Path) -> str:
    result = json.loads(path.read_text())
    runs = "\n".join(run_line(run, path.name) for run in result["runs"])
    body = [block if isinstance(block, str) else table(block) for block in result["body"]]
    heading = "#" * result["level"] + " " + result["title"]
    return "\n\n".join(part for part in (heading, runs, *body) if part)


def page(results: Path = RESULTS) -> str:
    return "\n\n".join(section(path) for path in sorted(results.glob("*.json"))) + "\n"

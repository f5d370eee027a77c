"""Results of a benchmark as a file that scripts/benchmarks_page.py reads."""

import datetime
import json
import re
import shlex
import subprocess
import sys
from pathlib import Path


def commit() -> str | None:
    """The commit that is checked out; None outside a clone."""
    asked = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"],
        cwd=Path(__file__).parent,
        capture_output=True,
        text=True,
    )
    return asked.stdout.strip() or None


def processor() -> str | None:
    """The name that Linux gives the processor; None elsewhere."""
    about = Path("/proc/cpuinfo")
    found = about.is_file() and re.search(r"model name\s*: (.+)", about.read_text())
    return found[1] if found else None


def write(
    path: Path, title: str, seed: int, columns: list[str], rows: list[list[str]], notes=()
) -> None:
    """Writes one table of this run, and paragraphs below it."""
    run = {
        "command": shlex.join(["python", *sys.argv]),
        "seed": seed,
        "machine": processor(),
        "date": datetime.date.today().isoformat(),
        "commit": commit(),
    }
    result = {
        "title": title,
        "level": 3,
        "runs": [run],
        "body": [{"columns": columns, "rows": rows}, *notes],
    }
    path.write_text(json.dumps(result, indent=1, ensure_ascii=False) + "\n")

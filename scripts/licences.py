#!/usr/bin/env python3
"""Licences of the crates and fonts that are part of the wheel, as one text that goes along with it.

    scripts/licences.py --out FILE     write it anew, after a change of Cargo.lock
    scripts/licences.py --check FILE   whether it is of the crates that are linked now

Refuses crates under licences that deny.toml does not allow, and those that do not come from
crates.io, whether they are linked or only build and test it. Nothing is fetched but what cargo
needs to build.
"""

import argparse
import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
PERMISSIVE = set(tomllib.loads((ROOT / "deny.toml").read_text())["licenses"]["allow"])
REGISTRY = "registry+https://github.com/rust-lang/crates.io-index"
FONTS = {"Inter, a part of it (font)": "crates/mvtop-core/assets/inter-LICENSE.txt"}
TEXTS = re.compile(r"(licen[cs]e|copying|notice|unlicense)", re.IGNORECASE)


def metadata() -> dict:
    """What cargo says of the workspace and all that it builds on."""
    command = ["cargo", "metadata", "--format-version", "1", "--locked"]
    return json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)


def linked(about: dict) -> list[dict]:
    """The crates from elsewhere that `mvtop-py` is built of, by name."""
    packages = {package["id"]: package for package in about["packages"]}
    nodes = {node["id"]: node for node in about["resolve"]["nodes"]}
    found, open_ = set(), [i for i, p in packages.items() if p["name"] == "mvtop-py"]
    while open_:
        package = open_.pop()
        if package in found:
            continue
        found.add(package)
        for dependency in nodes[package]["deps"]:
            # Neither what builds it nor what tests it is in it.
            if any(kind["kind"] is None for kind in dependency["dep_kinds"]):
                open_.append(dependency["pkg"])
    crates = [packages[package] for package in found if packages[package]["source"]]
    return sorted(crates, key=lambda crate: (crate["name"], crate["version"]))


def permitted(expression: str) -> bool:
    """Whether there is a way to use a crate under permissive licences alone.

    - expression: SPDX's, where AND binds tighter than OR
    """
    words = re.findall(r"[()]|[^\s()]+", expression.replace("/", " OR "))

    def take(word: str) -> bool:
        return words[:1] == [word] and bool(words.pop(0))

    def either() -> bool:
        found = both()
        while take("OR"):
            found = both() or found
        return found

    def both() -> bool:
        found = one()
        while take("AND"):
            found = one() and found
        return found

    def one() -> bool:
        if take("("):
            return either() and take(")")
        licence = words.pop(0) if words else ""
        if take("WITH"):
            licence += f" WITH {words.pop(0) if words else ''}"
        return licence in PERMISSIVE

    return either() and not words


def refuse(crates: list[dict]):
    """Ends with an error where one of them may not be used."""
    wrong = [f"{c['name']} ({c['license']})" for c in crates if not permitted(c["license"] or "")]
    if wrong:
        sys.exit(f"error: expected permissive licences, got {', '.join(wrong)}; fix: another crate")
    foreign = [f"{c['name']} ({c['source']})" for c in crates if c["source"] != REGISTRY]
    if foreign:
        got = ", ".join(foreign)
        sys.exit(f"error: expected crates of crates.io, got {got}; fix: name a release")


def texts(crate: dict) -> list[Path]:
    """The files of a crate's licences; of MIT or Apache-2.0, of which one is enough, MIT's."""
    files = sorted(Path(crate["manifest_path"]).parent.iterdir())
    files = [path for path in files if TEXTS.match(path.name) and path.is_file()]
    mit = any("mit" in path.name.lower() for path in files)
    return [path for path in files if not (mit and "apache" in path.name.lower())]


def text(crates: list[dict]) -> str:
    of_text: dict[str, list[str]] = {}
    lines = ["Crates and fonts that are part of mvtop's wheel, and their licences.", ""]
    for crate in crates:
        name = f"{crate['name']} {crate['version']}"
        lines.append(f"{name}: {crate['license']}")
        for path in texts(crate):
            licence = path.read_text(encoding="utf-8", errors="replace")
            licence = "\n".join(line.rstrip() for line in licence.strip().splitlines())
            of_text.setdefault(licence, []).append(name)
    for name, path in FONTS.items():
        lines.append(f"{name}: OFL-1.1")
        of_text[(ROOT / path).read_text(encoding="utf-8").strip()] = [name]
    for licence, names in of_text.items():
        lines += ["", "=" * 80, f"Of {', '.join(names)}:", "", licence]
    return "\n".join(lines) + "\n"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, help="file to write")
    parser.add_argument("--check", type=Path, help="file to compare")
    args = parser.parse_args()
    about = metadata()
    refuse([package for package in about["packages"] if package["source"]])
    now = text(linked(about))
    if args.out:
        args.out.write_text(now, encoding="utf-8")
    if args.check and args.check.read_text(encoding="utf-8") != now:
        sys.exit(f"error: {args.check} is of other crates; fix: make licences")


if __name__ == "__main__":
    main()

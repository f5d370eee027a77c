"""Links of the documentation lead somewhere, and its generated pages are those of the code."""

import importlib.util
import json
import re
import sys
import unicodedata
from pathlib import Path

import pytest

import benchmarks_page

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted(
    [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
    + [
        page
        for folder in ("benches", "examples", "models", "crates/*")
        for page in ROOT.glob(f"{folder}/*.md")
    ]
)
SOURCES = [
    path
    for pattern in (
        "crates/*/src/**/*.rs", "crates/*/tests/**/*.rs", "crates/*/python/**/*.py*",
        "training/**/*.py", "training/mvtop_train/runs/*.toml", "benches/*.py", "scripts/*", "Makefile",
    )
    for path in ROOT.glob(pattern)
    if path.is_file() and path.suffix in {".rs", ".py", ".pyi", ".toml", ".sh", ""}
]  # fmt: skip
FENCE = re.compile(r"^(```|~~~).*?^\1", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"!?\[(?:[^\[\]]|\[[^\]]*\])*\]\(([^()\s]+)\)")
# Not of a longer path, as bop_toolkit/blob/master/docs/...
NAMED = re.compile(r"(?<![\w/.])docs/[\w/.-]+\.md")


def name(page: Path) -> str:
    return str(page.relative_to(ROOT))


def prose(page: Path) -> str:
    return FENCE.sub("", page.read_text())


def slug(heading: str) -> str:
    """The anchor that GitHub and the site give a heading."""
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).replace("`", "").strip().lower()
    kept = (c for c in text if c in " -_" or unicodedata.category(c)[0] in "LN")
    return "".join(kept).replace(" ", "-")


def anchors(page: Path) -> set[str]:
    return {slug(text) for text in re.findall(r"^#+ (.+)$", prose(page), re.MULTILINE)}


def broken(page: Path) -> list[str]:
    found = []
    for target in LINK.findall(re.sub(r"`[^`\n]*`", "", prose(page))):
        if re.match(r"[a-z]+:", target):
            continue
        path, _, anchor = target.partition("#")
        at = (page.parent / path).resolve() if path else page
        if not at.exists():
            found.append(f"{target}: no such file")
        elif anchor and (at.suffix != ".md" or anchor not in anchors(at)):
            found.append(f"{target}: no such heading")
    return found


def reference():
    spec = importlib.util.spec_from_file_location("reference", ROOT / "scripts/reference.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_relative_links_and_anchors_exist(page):
    assert not broken(page)


def test_a_broken_link_is_found(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(
        "# One heading\n[a](page.md) [b](#one-heading) [c](#two) [d](none.md)\n```\n[e](f)\n```\n"
    )
    assert broken(page) == ["#two: no such heading", "none.md: no such file"]


def test_every_page_is_in_an_index_and_in_the_site():
    docs = ROOT / "docs"
    pages = {page for page in docs.rglob("*.md") if page.name != "README.md"}
    listed = set()
    for index in docs.rglob("README.md"):
        listed |= {(index.parent / target).resolve() for target in LINK.findall(prose(index))}
    assert pages <= listed, [name(page) for page in pages - listed]
    nav = set(re.findall(r"[\w/.-]+\.md", (ROOT / "mkdocs.yml").read_text()))
    assert {str(page.relative_to(docs)) for page in pages} <= nav


def test_pages_named_in_the_code_exist():
    missing = {
        f"{name(path)}: {page}"
        for path in SOURCES
        for page in NAMED.findall(path.read_text(errors="ignore"))
        if not (ROOT / page).exists()
    }
    assert not missing


def test_generated_pages_are_those_of_the_code():
    module = reference()
    cli = Path(sys.executable).parent / "mvtop-cli"
    if not cli.is_file():
        pytest.skip("mvtop's wheel is not installed")
    for page, text in module.pages(cli):
        assert text == (ROOT / page).read_text(), f"{page}: make reference"


def test_the_benchmark_page_is_made_from_the_results():
    assert benchmarks_page.page() == (ROOT / benchmarks_page.PAGE).read_text(), "make reference"


def test_a_result_without_its_machine_is_refused(tmp_path):
    run = {"command": "make bench", "seed": 1, "machine": None, "date": None, "commit": None}
    result = {"title": "Speed", "level": 2, "runs": [run], "body": ["Text."]}
    (tmp_path / "a.json").write_text(json.dumps(result))
    assert benchmarks_page.page(tmp_path) == "## Speed\n\n- `make bench`; 1; ?; ?\n\nText.\n"
    del run["machine"]
    (tmp_path / "a.json").write_text(json.dumps(result))
    with pytest.raises(ValueError, match="a.json: a run needs"):
        benchmarks_page.page(tmp_path)


def test_a_benchmark_writes_what_the_page_reads(tmp_path):
    spec = importlib.util.spec_from_file_location("result_file", ROOT / "benches/result_file.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.write(tmp_path / "a.json", "Speed", 5, ["what", "ms"], [["reading", "3"]])
    page = benchmarks_page.page(tmp_path)
    assert "; 5; " in page and page.endswith("| what | ms |\n|---|---|\n| reading | 3 |\n")

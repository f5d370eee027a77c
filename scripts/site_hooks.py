"""Hooks of mkdocs.yml: pages of the root join the site; links to other files become text."""

import posixpath
import re
from pathlib import Path

from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parent.parent
PAGES = ("ARCHITECTURE.md", "CONVENTIONS.md", "CONTRIBUTING.md", "CHANGELOG.md")
LINK = re.compile(r"\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^()\s:]+)\)")


def on_files(files, config):
    for name in PAGES:
        text = (ROOT / name).read_text().replace("](docs/", "](")
        files.append(File.generated(config, name, content=text))
    return files


def on_page_markdown(markdown, page, config, files):
    folder = posixpath.dirname(page.file.src_uri)

    def of_site(match):
        text, target = match.groups()
        at = posixpath.normpath(posixpath.join(folder, target.partition("#")[0]))
        if not at.startswith("../"):
            return match[0]
        name = at.removeprefix("../")
        if name in PAGES:
            return f"[{text}]({posixpath.relpath(name, folder or '.')})"
        return text

    return LINK.sub(of_site, markdown)

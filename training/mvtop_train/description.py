"""`model.json`, what a bundle says of itself."""

import json
from pathlib import Path

from .files import read_json

NAME = "model.json"


def read(bundle: Path) -> dict:
    return read_json(bundle / NAME, "--bundle must name a bundle's folder")


def write(bundle: Path, description: dict):
    (bundle / NAME).write_text(json.dumps(description, indent=1) + "\n")

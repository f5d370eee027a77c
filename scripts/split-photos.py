#!/usr/bin/env python3
"""A BOP data set in two: images with even numbers, and those with odd ones.

    scripts/split-photos.py ../shared/data/photos out/photos

makes out/photos-even and out/photos-odd of its split `test`; their images are links to its own.
"""

import json
import sys
from pathlib import Path


def main(source: Path, to: str):
    for rest, name in enumerate(("even", "odd")):
        root = Path(f"{to}-{name}")
        if root.exists():
            sys.exit(f"error: {root}: expected no such folder, got one; fix: another name")
        root.mkdir(parents=True)
        (root / "models").symlink_to(source / "models")
        for scene in sorted(path.parent for path in source.glob("test/*/scene_camera.json")):
            folder = root / "test" / scene.name
            (folder / "rgb").mkdir(parents=True)
            for file in scene.glob("scene_*.json"):
                listed = json.loads(file.read_text()).items()
                kept = {key: value for key, value in listed if int(key) % 2 == rest}
                (folder / file.name).write_text(json.dumps(kept))
            images = [path for path in (scene / "rgb").iterdir() if int(path.stem) % 2 == rest]
            for path in images:
                (folder / "rgb" / path.name).symlink_to(path)
            print(f"{folder}: {len(images)} images")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(Path(sys.argv[1]).resolve(), sys.argv[2])

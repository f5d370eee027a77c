"""What was accepted, for a person: pictures, and a list in which lines can be struck out."""

import base64
import html
from pathlib import Path

import cv2
import numpy as np

from ..data import bop
from ..data.objects import Object
from ..errors import UserError
from ..files import read_text, write_text
from .accept import Pose
from .labels import Labels

LIST, PAGE = "accepted.txt", "accepted.html"
SIDE = 200  # px, of a picture
AROUND = 0.25  # of a box's longer side, shown beside it
HEAD = (
    "## Poses that are learnt from; accepted.html shows them. Put a # before a line to strike it\n"
    "## out, and run the same command again with --force.\n"
    "## exposure\tobject\tx, y, z in mm\tconfidence\timages\n"
)
STYLE = (
    "body{font:15px sans-serif;margin:2em}img{height:160px;margin:2px}h2{font-size:1em;"
    "margin:1.2em 0 .2em}"
)


def struck(out: Path, known: tuple[Object, ...]) -> list[Pose]:
    """The poses that a person has struck out in the list of a folder; only their places are known.

    UserError where a struck line is none of ours.
    """
    path = out / LIST
    if not path.exists():
        return []
    by_name, found = {obj.name: obj for obj in known}, []
    for number, line in enumerate(read_text(path, "delete it").splitlines(), 1):
        if not line.startswith("#") or line.startswith("##"):
            continue
        try:
            scene, name, place, confidence, views = line.lstrip("# ").split("\t")
            pose = np.eye(4)
            pose[:3, 3] = np.array(place.split(), float) / 1e3
            found.append(Pose(scene, by_name[name], pose, float(confidence), int(views)))
        except (ValueError, KeyError):
            raise UserError(
                f"{path}: line {number}: expected a line of this list after a #, got {line!r}; "
                "fix: as it was written, with tabs, or take the line out"
            ) from None
    return found


def write(out: Path, labels: Labels, struck_out: list[Pose], photographs: Path):
    """Writes both into a folder.

    - photographs: data set that was made of these labels (`labels.write`)
    """
    lines = [_line(one, labels.images_of(one)) for one in labels.poses]
    gone = ["# " + _line(one, one.views) for one in struck_out]
    write_text(out / LIST, HEAD + "".join(f"{line}\n" for line in [*lines, *gone]))
    parts = [
        "<!doctype html><meta charset=utf-8><title>accepted</title>", f"<style>{STYLE}</style>",
        f"<h1>{len(labels.poses)} accepted poses in {labels.count} images</h1>"
        f"<p>Does each outline lie on its object, in every picture? Where one does not, put a # "
        f"before its line in {LIST} and run the same command again with --force.</p>",
    ]  # fmt: skip
    pictures = _pictures(photographs)
    for pose, line in zip(labels.poses, lines, strict=True):
        parts.append(f"<h2>{html.escape(line)}</h2>")
        parts += pictures.get(_key(pose.obj.id, pose.world_from_obj), ["no image speaks for it"])
    write_text(out / PAGE, "\n".join(parts) + "\n")


def _line(pose: Pose, images: int) -> str:
    place = " ".join(f"{x:.1f}" for x in 1e3 * pose.world_from_obj[:3, 3])
    return "\t".join([pose.scene, pose.obj.name, place, f"{pose.confidence:.2f}", str(images)])


def _key(obj_id: int, world_from_obj: np.ndarray) -> tuple:
    return obj_id, *np.round(1e3 * world_from_obj[:3, 3]).astype(int).tolist()


def _pictures(photographs: Path) -> dict[tuple, list[str]]:
    """By object and place, what each labelled image shows there, as elements of a page."""
    found: dict[tuple, list[str]] = {}
    for folder in bop.whole_scenes(photographs / "train"):
        for image in bop.read_images(folder):
            rgb = bop.read_rgb(image.path)
            _, owners = bop.read_coords(image, rgb.shape[:2])
            for one in image.instances:
                world_from_obj = np.linalg.inv(image.cam_from_world) @ one.cam_from_obj
                mask = (owners == one.annotation + 1).astype(np.uint8)
                key = _key(one.obj_id, world_from_obj)
                found.setdefault(key, []).append(_picture(rgb, mask))
    return found


def _picture(rgb: np.ndarray, mask: np.ndarray) -> str:
    """The part of an image that shows an object, its outline drawn."""
    v, u = np.nonzero(mask)
    reach = int((1 / 2 + AROUND) * max(np.ptp(u), np.ptp(v), 8))
    x, y = int(u.min() + u.max()) // 2, int(v.min() + v.max()) // 2
    top, left = max(y - reach, 0), max(x - reach, 0)
    window = slice(top, y + reach + 1), slice(left, x + reach + 1)
    part, scale = np.ascontiguousarray(rgb[window]), SIDE / (2 * reach + 1)
    part = cv2.resize(part, None, fx=scale, fy=scale, interpolation=cv2.INTER_LINEAR)
    seen = cv2.resize(mask[window], part.shape[1::-1], interpolation=cv2.INTER_NEAREST)
    outlines, _ = cv2.findContours(seen, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(part, outlines, -1, (0, 255, 0), 1)
    coded = cv2.imencode(".jpg", part[:, :, ::-1])[1].tobytes()
    return f'<img src="data:image/jpeg;base64,{base64.b64encode(coded).decode()}">'

"""Look at a data set: a contact sheet and statistics of one split.

    mvtop-train dataset-report --data data/mvball --split hard --out out/report

Writes contact_sheet.png (pairs side by side, the amodal box drawn in), statistics.json and
statistics.png. Works on any data set in BOP layout with one object per image.
"""

import json
from pathlib import Path

import cv2
import numpy as np

from ..data import bop, objects, pairs, surface
from ..errors import UserError, argument_parser, command

COLORS = {"green": (60, 200, 60), "red": (230, 60, 60)}  # of boxes, by the hemisphere in sight
DIRECTIONS, ROLLS = 72, 12  # cells in which viewing directions and rolls are counted


def thumbnail(image: bop.Image, label: str, size: tuple[int, int]) -> np.ndarray:
    """The image [h, w, 3] BGR in a frame of `size` = (w, h), with its box and a label."""
    picture = cv2.imread(str(image.path), cv2.IMREAD_COLOR)
    scale = min(size[0] / picture.shape[1], size[1] / picture.shape[0])
    small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    color = COLORS.get(image.shows, (255, 220, 0))[::-1]
    x0, y0, x1, y1 = (int(round((x + 0.5) * scale - 0.5)) for x in image.box)
    cv2.rectangle(small, (x0, y0), (x1, y1), color, 1)
    for thickness, ink in ((3, (0, 0, 0)), (1, (255, 255, 255))):
        cv2.putText(small, label, (4, 13), cv2.FONT_HERSHEY_SIMPLEX, 0.42, ink, thickness)
    frame = np.full((size[1], size[0], 3), 255, np.uint8)
    frame[: small.shape[0], : small.shape[1]] = small[: size[1], : size[0]]
    return frame


def contact_sheet(scenes: dict, rows: int = 8, columns: int = 3, size=(240, 180)) -> np.ndarray:
    """A grid [h, w, 3] BGR of pairs from scenes spread evenly over the split."""
    numbers = list(scenes)
    picked = [numbers[i] for i in np.linspace(0, len(numbers) - 1, rows * columns).astype(int)]
    cells = []
    for number in dict.fromkeys(picked):
        images = scenes[number]
        found = pairs.of_scene({n: image.shows for n, image in enumerate(images)})
        pair = found[number % len(found)] if found else (0,)
        shown = [
            thumbnail(images[n], f"scene {number} image {images[n].path.stem}", size) for n in pair
        ]
        shown += [np.full_like(shown[0], 255)] * (2 - len(shown))
        cells.append(cv2.copyMakeBorder(np.hstack(shown), 3, 3, 3, 3, 0, value=(255, 255, 255)))
    columns = min(columns, len(cells))
    cells += [np.full_like(cells[0], 255)] * (-len(cells) % columns)
    return np.vstack([np.hstack(cells[i : i + columns]) for i in range(0, len(cells), columns)])


def viewpoint(cam_from_obj: np.ndarray) -> tuple[np.ndarray, float]:
    """Unit vector from object to camera in the object's frame, and the roll about it (rad)."""
    rotation, t = cam_from_obj[:3, :3], cam_from_obj[:3, 3]
    direction = -rotation.T @ t / np.linalg.norm(t)
    # The image of the object axis that is farthest from the line of sight.
    axis = np.eye(3)[np.abs(direction).argmin()]
    x, y, _ = rotation @ axis
    return direction, float(np.arctan2(y, x))


def coverage(cells: np.ndarray, count: int) -> dict:
    """How many of `count` equal cells are hit, beside what even chance would hit."""
    hit = len(np.unique(cells)) / count
    return {"cells": count, "hit": hit, "hit_by_even_chance": 1 - (1 - 1 / count) ** len(cells)}


def statistics(scenes: dict) -> dict:
    """Counts, and the values that the histograms are of, one per image."""
    images = [image for scene in scenes.values() for image in scene]

    def known(values) -> list:
        return [value for value in values if value is not None]

    views = [viewpoint(image.cam_from_obj) for image in images]
    directions = np.stack([direction for direction, _ in views])
    cell = (directions @ surface.directions(DIRECTIONS).T).argmax(1)
    roll = np.floor((np.array([r for _, r in views]) / (2 * np.pi) % 1) * ROLLS).astype(int)
    shows = [str(image.shows) for image in images]
    found = (pairs.of_scene({n: i.shows for n, i in enumerate(s)}) for s in scenes.values())
    return {
        "scenes": len(scenes),
        "images": len(images),
        "pairs": sum(len(p) for p in found),
        "images_by_hemisphere": {name: shows.count(name) for name in sorted(set(shows))},
        "viewing_directions": coverage(cell, DIRECTIONS),
        "rotations": coverage(cell * ROLLS + roll, DIRECTIONS * ROLLS),
        "values": {
            "distance_m": [float(np.linalg.norm(i.cam_from_obj[:3, 3])) for i in images],
            "box_px": [float((i.box[2:] - i.box[:2]).max()) for i in images],
            "hemisphere_px": known(i.only.info.get("px_count_hemisphere") for i in images),
            "visible_share": known(image.only.visible_share for image in images),
            "azimuth_deg": np.rad2deg(np.arctan2(directions[:, 1], directions[:, 0])).tolist(),
            "z": directions[:, 2].tolist(),
        },
    }  # fmt: skip


def summary(stats: dict) -> dict:
    """`statistics` with each list of values reduced to quantiles and a histogram."""
    out = {name: value for name, value in stats.items() if name != "values"}
    for name, values in stats["values"].items():
        if values:
            counts, edges = np.histogram(values, 20)
            quantiles = np.quantile(values, [0, 0.05, 0.5, 0.95, 1])
            out[name] = {
                "min_p5_median_p95_max": [round(float(q), 4) for q in quantiles],
                "histogram": counts.tolist(),
                "edges": [round(float(edge), 4) for edge in edges],
            }
    return out


def plot(stats: dict, path: Path, title: str):
    try:
        import matplotlib
    except ImportError:
        raise UserError(
            "statistics.png: expected matplotlib, got none; fix: pip install matplotlib"
        ) from None
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    values = stats["values"]
    figure, axes = plt.subplots(2, 3, figsize=(13, 7.5), layout="constrained")
    for axis, (name, label) in zip(
        axes.flat,
        (
            ("hemisphere_px", "visible pixels of the hemisphere"),
            ("visible_share", "visible share of the outline"),
            ("distance_m", "distance of the camera, m"),
            ("box_px", "longer side of the amodal box, px"),
        ),
        strict=False,
    ):
        if values[name]:
            bins = np.geomspace(max(min(values[name]), 1), max(values[name]) + 1, 40)
            axis.hist(values[name], bins if name == "hemisphere_px" else 40)
            if name == "hemisphere_px":
                axis.set_xscale("log")
        axis.set(xlabel=label if values[name] else f"{label}: not in this data set")
        axis.set(ylabel="images")
    axis = axes.flat[4]
    drawn = axis.hist2d(
        values["azimuth_deg"], values["z"], [36, 18], range=[[-180, 180], [-1, 1]], cmin=1
    )
    axis.set(xlabel="azimuth of the camera about the object, deg", ylabel="z (equal areas)")
    axis.set(title=f"{stats['viewing_directions']['hit']:.0%} of directions, "
             f"{stats['rotations']['hit']:.0%} of rotations")  # fmt: skip
    figure.colorbar(drawn[3], ax=axis, label="images")
    counts = stats["images_by_hemisphere"]
    axes.flat[5].bar([{"None": "any"}.get(n, n) for n in counts], counts.values())
    axes.flat[5].set(xlabel="hemisphere in sight", ylabel="images")
    figure.suptitle(f"{title}: {stats['images']} images, {stats['scenes']} scenes")
    figure.savefig(path, dpi=90)
    plt.close(figure)


@command
def main():
    parser = argument_parser(__doc__)
    parser.add_argument("--data", type=Path, default=Path("data/mvball"))
    parser.add_argument("--split", default="train")
    parser.add_argument("--object", type=int, metavar="ID", help="of the objects in --data")
    parser.add_argument("--out", type=Path, default=Path("out/report"))
    args = parser.parse_args()
    obj = objects.read(args.data, args.object)
    scenes = bop.read_split(args.data, args.split, obj)
    args.out.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(args.out / "contact_sheet.png"), contact_sheet(scenes))
    stats = statistics(scenes)
    (args.out / "statistics.json").write_text(json.dumps(summary(stats), indent=1) + "\n")
    plot(stats, args.out / "statistics.png", f"{obj.name}, {args.split}")
    print(f"{args.out}: {stats['images']} images in {stats['scenes']} scenes")


if __name__ == "__main__":
    main()

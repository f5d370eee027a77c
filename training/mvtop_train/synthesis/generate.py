"""Makes the scenes of a split: of MV-ball, or of a user's part through the user's rig.

Every scene is drawn from (seed, split, scene number) alone, so that a run can be stopped, split
into shards and resumed without changing the data. Scenes that are whole are left as they are.
What imports MuJoCo is imported late: `gl.open_gl` says first where OpenGL is missing.
"""

import hashlib
from pathlib import Path

import numpy as np
from tqdm import tqdm

from ..data import bop, objects, pairs, rig
from ..errors import UserError
from .gl import open_gl
from .recipe import MIN_PIXELS, PAPER_IMAGES, SPLITS, Recipe, hemispheres, views_per_scene
from .workers import run_workers, while_asked_for


def scene_views(gl, seed: int, split: str, index: int, order: list[str], size=(640, 480)):
    """The views of scene `index`: drops scenes until one shows every hemisphere of `order`."""
    from . import scenes

    textures = np.random.default_rng([seed, SPLITS[split], index // 50, 7])
    pool = [scenes.noise_texture(textures) for _ in range(12)]
    rng = np.random.default_rng([seed, SPLITS[split], index])
    while True:
        views = scenes.views_of_scene(rng, gl, pool, order, MIN_PIXELS[split], size)
        if views:
            return views


def _ball_work(job):
    recipe, out, tasks, queue = job
    gl, ball = open_gl(), objects.ball()
    for number, views in while_asked_for(tasks):
        folder = Path(out) / recipe.split / f"{number:06d}"
        if not bop.is_whole(folder):
            order = hemispheres(recipe.split, number, views)
            found = scene_views(gl, recipe.seed, recipe.split, number, order, recipe.size)
            bop.write_scene(folder, found, ball)
        queue.put(number)


def _part_work(job):
    recipe, out, tasks, queue = job
    from . import parts, scenes

    mesh = objects.load_mesh(recipe.mesh, recipe.mesh_unit)
    part = parts.Part(mesh, objects.from_mesh(mesh, 1, recipe.name))
    cameras = [camera.at_width(recipe.size[0]) for camera in rig.load(recipe.rig)]
    gl = open_gl()
    for number, _ in while_asked_for(tasks):
        folder = Path(out) / recipe.split / f"{number:06d}"
        if not bop.is_whole(folder):
            rng = np.random.default_rng([recipe.seed, SPLITS[recipe.split], number])
            pool = [scenes.noise_texture(rng) for _ in range(6)]
            views, names = parts.scene_views(gl, rng, pool, part, cameras)
            bop.write_scene(folder, views, part.obj, names)
        queue.put(number)


def prepare(args) -> tuple[Recipe, object]:
    """The recipe without its split, and the worker; writes `models/`."""
    out = Path(args.out)
    if not args.mesh:
        objects.write(out, objects.ball(), objects.ball_mesh())
        size = (640, 480) if args.window is None else (args.window, args.window)
        return Recipe(args.seed, "", size), _ball_work
    if len(args.mesh) > 1:
        raise UserError(
            f"--mesh: expected one part, got {len(args.mesh)}; fix: one data set for each, "
            "as a network of several classes is not supported yet"
        )
    for name in ("rig", "mesh_unit"):
        if getattr(args, name) is None:
            option = name.replace("_", "-")
            raise UserError(f"--{option}: expected with --mesh, got none; fix: add it")
    from . import parts

    mesh = objects.load_mesh(args.mesh[0], args.mesh_unit)
    part = objects.from_mesh(mesh, 1, args.name or Path(args.mesh[0]).stem)
    parts.Part(mesh, part)  # refuses what cannot fall
    cameras = rig.load(args.rig)
    parts.check_rig(cameras, part, args.rig)
    bent = [camera.id for camera in cameras if camera.distorted]
    if bent:
        print(f"note: images of {', '.join(bent)} are rendered without lens distortion, as "
              "undistorted images with the same fx, fy, cx, cy would be")  # fmt: skip
    offset = abs(mesh.bounds.mean(0)).max()
    if offset > 0.2 * part.diameter_m:
        print(f"note: the mesh's origin is {offset * 1e3:.0f} mm off its middle; poses are of "
              "this origin, but are learnt better if it is inside the part")  # fmt: skip
    objects.write(out, part, mesh)
    unit = args.mesh_unit
    content = Path(args.mesh[0]).read_bytes() + unit.encode() + Path(args.rig).read_bytes()
    source = hashlib.sha256(content).hexdigest()[:16]
    recipe = Recipe(
        args.seed, "", (args.width, 0), args.mesh[0], unit, part.name, str(args.rig), source
    )
    return recipe, _part_work


def make_split(recipe: Recipe, work, args, shard: int, shards: int):
    images = PAPER_IMAGES.get(recipe.split) if args.paper else args.images
    if args.paper and images is None:
        raise UserError(
            f"--paper: expected a split of {list(PAPER_IMAGES)}, got {recipe.split!r}; "
            "fix: --images"
        )
    counts = views_per_scene(images, args.views) if images else [args.views] * args.scenes
    folder = Path(args.out) / recipe.split
    recipe.check(folder)
    run_workers(
        work,
        list(enumerate(counts))[shard::shards],
        args.workers,
        lambda part, queue: (recipe, args.out, part, queue),
        tqdm(total=len(counts[shard::shards]), unit="scene", smoothing=0.05, desc=recipe.split),
    )
    scenes, images, pair_count = pairs.write(folder)
    print(f"{folder}: {images} images in {scenes} scenes, {pair_count} pairs")

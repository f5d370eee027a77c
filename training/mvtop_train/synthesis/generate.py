"""Makes the scenes of a split: of MV-ball, or of a user's part through the user's rig.

Every scene is drawn from (seed, split, scene number) alone, so that a run can be stopped, split
into shards and resumed without changing the data. Scenes that are whole are left as they are.
What imports MuJoCo is imported late: `gl.open_gl` says first where OpenGL is missing.
"""

import hashlib
import itertools
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from .. import files
from ..data import backgrounds, bop, meshfile, objects, pairs, rig
from ..errors import UserError
from . import cad
from .gl import open_gl
from .recipe import MIN_PIXELS, PAPER_IMAGES, SPLITS, PartFile, Recipe, hemispheres, views_per_scene
from .workers import run_workers, while_asked_for

NUMBERED = re.compile(r"obj_(\d{6})")  # as BOP's meshes are
LAST_ID = 999_999  # of six digits
MESHES = (*meshfile.MESHES, *cad.ENDINGS)
SAME_SIZE = 0.1  # by how much, as a share, a part's diameter may be another than is told of it


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
    gl = open_gl()
    for number, views in while_asked_for(tasks):
        folder = Path(out) / recipe.split / f"{number:06d}"
        if not bop.is_whole(folder):
            order = hemispheres(recipe.split, number, views)
            found = scene_views(gl, recipe.seed, recipe.split, number, order, recipe.size)
            bop.write_scene(folder, found)
        queue.put(number)


def kit_of(recipe: Recipe):
    """The parts of a recipe with their meshes (m), as they fall together."""
    from . import parts

    meshes = [meshfile.load_mesh(part.mesh, part.unit) for part in recipe.parts]
    known = [
        objects.from_mesh(mesh, part.id, part.name, *part.symmetries)
        for mesh, part in zip(meshes, recipe.parts, strict=True)
    ]
    kit = parts.Kit([parts.Part(*x) for x in zip(meshes, known, strict=True)], recipe.most)
    return kit, list(zip(known, meshes, strict=True))


def _part_work(job):
    recipe, out, tasks, queue = job
    gl = open_gl()
    from . import parts, rigs, scenes

    kit, _ = kit_of(recipe)
    width = recipe.size[0]
    own = [[camera.at_width(width) for camera in rig.load(path)] for path in recipe.rigs]
    photos = scenes.Photos(recipe.backgrounds)

    def rig_of(rng):
        return own[rng.integers(len(own))] if own else rigs.random_rig(rng, kit.diameter, width)

    for number, _ in while_asked_for(tasks):
        folder = Path(out) / recipe.split / f"{number:06d}"
        if not bop.is_whole(folder):
            rng = np.random.default_rng([recipe.seed, SPLITS[recipe.split], number])
            pool = [scenes.noise_texture(rng) for _ in range(6)]
            pool += [photos.texture(rng) for _ in range(6 if photos else 0)]
            pool += [kit.texture(rng) for _ in range(2)]
            views, names = parts.scene_views(gl, rng, pool, kit, rig_of)
            bop.write_scene(folder, views, names)
        queue.put(number)


def prepare(args) -> tuple[Recipe, object]:
    """The recipe without its split, and the worker; writes `models/`."""
    out = Path(args.out)
    if not args.mesh:
        size = (640, 480) if args.window is None else (args.window, args.window)
        recipe = Recipe(args.seed, "", size)
        _begin(out, args.split, recipe, [(objects.ball(), objects.ball_mesh())])
        return recipe, _ball_work
    if args.mesh_unit is None and not all(map(cad.is_step, args.mesh)):
        raise UserError("--mesh-unit: expected with --mesh, got none; fix: --mesh-unit mm")
    listed = part_files(args)
    rigs = tuple(map(str, args.rig or ()))
    digest = hashlib.sha256(f"{args.mesh_unit} {args.instances}".encode())
    for path in (*args.mesh, *rigs):
        if files.is_bounded(path, meshfile.MESH_BYTES):  # others are refused where they are read
            digest.update(Path(path).read_bytes())
        if cad.is_step(path):
            digest.update(f"{cad.CHORD} {cad.ANGLE}".encode())
    if args.backgrounds:
        digest.update(backgrounds.fingerprint(args.backgrounds))
    meshes = tuple(as_mesh(part, out) for part in listed)
    recipe = Recipe(
        args.seed, "", (args.width, 0), "+".join(part.name for part in listed), meshes,
        args.instances, rigs, args.backgrounds, digest.hexdigest()[:16],
    )  # fmt: skip
    open_gl()  # refuses what would come up in every worker
    kit, known = kit_of(recipe)  # refuses what cannot fall
    from . import parts

    for part, (obj, _) in zip(listed, known, strict=True):
        _refuse_another(part, obj.diameter_m)
    beside = hashlib.sha256(repr([part.symmetries for part in listed]).encode())
    for _, mesh in known:
        beside.update(mesh.metadata["beside"].encode())
    recipe = replace(recipe, beside=beside.hexdigest()[:16])
    for path in rigs:
        cameras = rig.load(path)
        for obj, _ in known:
            parts.check_rig(cameras, obj, path)
        bent = [camera.id for camera in cameras if camera.distorted]
        if bent:
            print(
                f"note: images of {', '.join(bent)} are rendered without distortion and skew, as "
                "undistorted images with the same fx, fy, cx, cy would be",
                flush=True,
            )
    for obj, mesh in known:
        offset = abs(mesh.bounds.mean(0)).max()
        if offset > 0.2 * obj.diameter_m:
            print(
                f"note: {obj.name}: the mesh's origin is {offset * 1e3:.0f} mm off its middle; "
                "poses are of this origin, but are learnt better if it is inside the part",
                flush=True,
            )
    _begin(out, args.split, recipe, known)
    return recipe, _part_work


def as_mesh(part: PartFile, out: Path) -> PartFile:
    """The part; of a STEP file, its triangles below `out`, in metres."""
    if not cad.is_step(part.mesh):
        return part
    made = out / "cad" / f"{part.id:06d}.glb"
    cad.to_mesh(part.mesh, part.unit, made)
    return replace(part, mesh=str(made), unit="m")


def _begin(out: Path, splits: list[str], recipe: Recipe, known):
    """Writes `models/`, unless that is another's."""
    for split in splits:
        recipe.check(out / split)
    objects.write(out, known)


def part_files(args) -> tuple[PartFile, ...]:
    """The parts that --mesh, --id and --name give; files of BOP's sets are numbered already, and
    `models_info.json` beside them says more of them."""
    for option in ("id", "name"):
        given = getattr(args, option)
        if given and len(given) != len(args.mesh):
            raise UserError(
                f"--{option}: expected one for each --mesh ({len(args.mesh)}), got {len(given)}; "
                "fix: as many, in the same order"
            )
    matches = [NUMBERED.fullmatch(Path(path).stem) for path in args.mesh]
    own = [int(match[1]) if match else None for match in matches]
    free = (number for number in itertools.count(1) if number not in own)
    ids = args.id or [next(free) if number is None else number for number in own]
    numbers = [mine if mine is not None else given for mine, given in zip(own, ids, strict=True)]
    for number in ids:
        if not 0 <= number <= LAST_ID:
            raise UserError(f"--id: expected 0 to {LAST_ID}, got {number}; fix: --id 1")
    infos = _infos(args.mesh, numbers)
    names = args.name or [
        getattr(info, "name", None) or Path(path).stem
        for path, info in zip(args.mesh, infos, strict=True)
    ]
    for name in names:
        if not objects.is_file_name(name):
            raise UserError(
                f"--name: expected names that files can have, got {name!r}; fix: --name for each"
            )
    for option, values in (("id", ids), ("name", names)):
        twice = [x for x in values if values.count(x) > 1]
        if twice:
            raise UserError(
                f"--{option}: expected each once, got {twice[0]} twice; fix: --{option} for each"
            )
    return tuple(
        PartFile(
            path, args.mesh_unit, number, name,
            *((objects.symmetries(info), info.diameter_m) if info else ()),
        )
        for path, number, name, info in zip(args.mesh, ids, names, infos, strict=True)
    )  # fmt: skip


def _infos(meshes: list[str], numbers: list[int]) -> list:
    """What the `models_info.json` beside each mesh says of it, None where there is no such file."""
    files, found = [Path(path).with_name(objects.INFO) for path in meshes], []
    for path, file, number in zip(meshes, files, numbers, strict=True):
        if not file.exists():
            found.append(None)
            continue
        infos = objects.read_infos(file)
        if not NUMBERED.fullmatch(Path(path).stem):
            number = _entry_of(Path(path), number, infos, alone=files.count(file) == 1)
        if number not in infos:
            raise UserError(
                f"{file}: expected object {number}, which {Path(path).name} is, got "
                f"{sorted(infos)}; fix: say there what is known of it, its diameter at least, or "
                "move the mesh to another folder"
            )
        found.append(infos[number])
    return found


def _entry_of(mesh: Path, number: int, infos: dict, alone: bool) -> int:
    """Which of the entries tells of a mesh without a number: the one of its name, else of `number`;
    of the one mesh of a folder, the one there is.

    alone  whether no other mesh of its folder is given
    """
    named = [entry for entry, info in infos.items() if info.name == mesh.stem]
    if named or number in infos:
        return (named or [number])[0]
    beside = sum(other.suffix.lower() in MESHES for other in mesh.parent.iterdir())
    return next(iter(infos)) if alone and beside <= 1 and len(infos) == 1 else number


def _refuse_another(part: PartFile, diameter_m: float):
    """UserError where the file beside a mesh tells of another part than it is."""
    told = part.diameter_m
    if told is not None and abs(told / diameter_m - 1) > SAME_SIZE:
        raise UserError(
            f"{Path(part.mesh).with_name(objects.INFO)}: expected a diameter of "
            f"{diameter_m * 1e3:.1f} mm, that of {Path(part.mesh).name}, got {told * 1e3:.1f} mm "
            'in the entry taken for it; fix: give the entry a "name", that of the file, or check '
            "--mesh-unit"
        )


def make_split(recipe: Recipe, work, args, shard: int, shards: int):
    images = PAPER_IMAGES.get(recipe.split) if args.paper else args.images
    if args.paper and images is None:
        raise UserError(
            f"--paper: expected a split of {list(PAPER_IMAGES)}, got {recipe.split!r}; "
            "fix: --images"
        )
    counts = views_per_scene(images, args.views) if images else [args.views] * args.scenes
    folder = Path(args.out) / recipe.split
    run_workers(
        work,
        list(enumerate(counts))[shard::shards],
        args.workers,
        lambda part, queue: (recipe, args.out, part, queue),
        tqdm(total=len(counts[shard::shards]), unit="scene", smoothing=0.05, desc=recipe.split),
    )
    scenes, images, pair_count = pairs.write(folder)
    print(f"{folder}: {images} images in {scenes} scenes, {pair_count} pairs")

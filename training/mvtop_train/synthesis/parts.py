"""Random scenes of a user's own parts, seen by the user's own rig.

The parts fall among distractors onto a random floor, under random lights; then the rig is placed
around one of them at random, and each of its cameras that sees enough of a part gives an image. All
that is the rig's (intrinsics, relative poses) stays as it is.
"""

from dataclasses import dataclass

import cv2
import mujoco
import numpy as np
import trimesh

from ..data.color import GAMMA
from ..data.meshfile import picture
from ..data.objects import Object
from ..data.rendered import Seen, View
from ..data.rig import Camera
from ..errors import UserError
from . import scenes, shading
from .render import FAR, GROUP, NEAR, Renderer

# The scene is built around parts of this mean size and scaled back: gravity, time step and
# distractors then suit a screw as well as a gearbox.
SCENE_DIAMETER = 0.13
LEAST_VISIBLE = 0.4  # of the outline, counting what is hidden and what is off the image
LEAST_PIXELS = 100
SIZES = (0.1, 0.85)  # of a part's diameter in the image, of the image's shorter side
TRIES = 300  # points in front of the rig, and turns of it, to choose from
CREASE = 30  # degrees by which two triangles are turned at an edge that looks sharp
NEAREST = 0.1  # of the smallest part's diameter: what is nearer to a camera is cut off
SURROUNDED = 0.6  # share of the scenes that pictures light (`shading`)
# Shares of metal among parts without a texture, and among all that is no part.
METAL, OTHER_METAL = 0.6, 0.2
TEXTURE = 1024  # px a side at most: the whole texture goes through the compiler for every scene


class Part:
    """A mesh as MuJoCo takes it: its assets, and bodies of it at a scale."""

    def __init__(self, mesh: trimesh.Trimesh, obj: Object):
        self.obj, self.name, self._mesh = obj, f"part{obj.id}", mesh
        self._uv, self.texture = _look(mesh)
        if self.texture is not None and max(self.texture.shape[:2]) > TEXTURE:
            shrink = TEXTURE / max(self.texture.shape[:2])
            self.texture = cv2.resize(
                self.texture, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA
            )
        rng = np.random.default_rng(0)
        scale = SCENE_DIAMETER / obj.diameter_m
        body = self.body(rng, "one", np.zeros(3))
        xml = f"<mujoco>{self.asset()}{body}</mujoco>"
        try:
            mujoco.MjModel.from_xml_string(xml, self.files(scale))
        except ValueError as error:
            reason = str(error).split("\n")[0].removeprefix("Error: ")
            raise UserError(
                f"mesh of {obj.name!r}: expected a body that can fall, got: {reason}; "
                "fix: a mesh with volume"
            ) from None

    def files(self, scale: float) -> dict[str, bytes]:
        """What `asset` names, of a scene in which everything is `scale` times as large."""
        files = {f"{self.name}.obj": _wavefront(self._mesh, self._uv, scale)}
        if self.texture is not None:
            png = cv2.imencode(".png", self.texture[:, :, ::-1])[1].tobytes()
            files[f"{self.name}.png"] = png
        return files

    def asset(self) -> str:
        name = self.name
        texture = f'<texture name="{name}" type="2d" file="{name}.png"/>'
        # Scanned meshes are seldom closed: "convex" gives each a mass center.
        return f"""<asset>{texture if self.texture is not None else ""}
            <mesh name="{name}" file="{name}.obj" inertia="convex" maxhullvert="64"/></asset>"""

    def body(self, rng: np.random.Generator, name: str, position: np.ndarray) -> str:
        """A body of this part; textureless parts have any color, or look like metal."""
        gloss = f'specular="{rng.uniform(0, 1):.2f}" shininess="{rng.uniform(0, 1):.2f}"'
        if self.texture is not None:
            gloss += f' texture="{self.name}"'
            look = np.clip(rng.uniform(0.8, 1.1) + rng.uniform(-0.05, 0.05, 3), 0, 1)
        elif rng.random() < 0.5:
            look = rng.uniform(0.05, 0.95, 3)
        else:
            look = np.clip(rng.uniform(0.2, 0.9) + rng.uniform(-0.06, 0.06, 3), 0, 1)
        quaternion = rng.normal(size=4)
        return f"""<asset><material name="{name}" rgba="{scenes.row(look)} 1" {gloss}/></asset>
          <worldbody>
            <body name="{name}" pos="{scenes.row(position)}" quat="{scenes.row(quaternion)}">
              <freejoint/>
              <geom name="{name}" type="mesh" mesh="{self.name}" mass="0.3" condim="6"
                    friction="1 0.01 0.005" material="{name}" group="{GROUP}"/>
            </body>
          </worldbody>"""


@dataclass(frozen=True)
class Fallen:
    """One part of a scene."""

    name: str  # of its body and geom
    obj: Object
    printed: bool  # whether it has a texture


class Kit:
    """The parts that fall together, each up to `most` times."""

    def __init__(self, parts: list[Part], most: int = 1):
        self.parts, self.most = parts, most
        self.diameter = float(np.exp(np.mean([np.log(p.obj.diameter_m) for p in parts])))
        self.scale = SCENE_DIAMETER / self.diameter
        smallest = min(p.obj.diameter_m for p in parts)
        self.near = min(NEAR, NEAREST * smallest * self.scale)
        self.files = {k: x for part in parts for k, x in part.files(self.scale).items()}

    def far(self, cameras: list[Camera]) -> float:
        """The far plane (m in the scene): well behind what a long lens sees at the least size."""
        largest = max(p.obj.diameter_m for p in self.parts) * self.scale
        focal = max(c.k[0, 0] / min(c.width, c.height) for c in cameras)
        return max(FAR, 1.5 * focal * largest / SIZES[0])

    def texture(self, rng: np.random.Generator) -> bytes:
        """PNG of a piece of some part's texture, for things that look like parts and are not."""
        textures = [part.texture for part in self.parts if part.texture is not None]
        if not textures:
            return scenes.noise_texture(rng)
        texture = textures[rng.integers(len(textures))]
        side = max(int(min(texture.shape[:2]) * rng.uniform(0.1, 0.4)), 1)
        y, x = (rng.integers(0, length - side + 1) for length in texture.shape[:2])
        return cv2.imencode(".png", texture[y : y + side, x : x + side, ::-1])[1].tobytes()

    def falling(self, rng: np.random.Generator) -> tuple[str, list[Fallen]]:
        """MJCF of some of them, and which."""
        counts = rng.integers(0, self.most + 1, len(self.parts))
        if len(self.parts) > 1 and self.most == 1:
            counts = (rng.random(len(self.parts)) < 0.7).astype(int)
        if counts.sum() == 0:
            counts[rng.integers(len(counts))] = 1
        chosen = [
            part for part, count in zip(self.parts, counts, strict=True) for _ in range(count)
        ]
        order = rng.permutation(len(chosen))
        xml, fallen = [], []
        for part in {part.name: part for part in chosen}.values():
            xml.append(part.asset())
        reach = 0.05 * np.sqrt(len(chosen))
        for place, index in enumerate(order):
            part = chosen[index]
            name = f"{part.name}_{place}"
            height = rng.uniform(0.1, 0.3) + 0.08 * place
            xml.append(part.body(rng, name, np.array([*rng.uniform(-reach, reach, 2), height])))
            fallen.append(Fallen(name, part.obj, part.texture is not None))
        return "".join(xml), fallen


def _look(mesh: trimesh.Trimesh):
    """(uv [faces, 3, 2], texture [h, w, 3] uint8), or (None, None) for a mesh without colors."""
    visual, corners = mesh.visual, len(mesh.faces) * 3
    if visual.kind == "texture":
        uv = np.asarray(visual.uv)[np.asarray(mesh.faces).ravel()]
        return uv.reshape(-1, 3, 2), np.asarray(picture(visual.material).convert("RGB"))
    if visual.kind is None:
        return None, None
    colors = np.asarray(visual.face_colors)[:, :3]
    # One texel per color; every corner of a face points to the middle of its texel.
    table, index = np.unique(colors, axis=0, return_inverse=True)
    side = int(np.ceil(np.sqrt(len(table))))
    texture = np.zeros((side * side, 3), np.uint8)
    texture[: len(table)] = table
    index = index.reshape(-1)
    uv = np.stack([(index % side + 0.5) / side, 1 - (index // side + 0.5) / side], 1)
    return uv.repeat(3, 0).reshape(corners // 3, 3, 2), texture.reshape(side, side, 3)


def _wavefront(mesh: trimesh.Trimesh, uv, scale: float) -> bytes:
    normals, index = np.unique(
        corner_normals(mesh).reshape(-1, 3).round(4), axis=0, return_inverse=True
    )
    lines = [f"v {x:.7g} {y:.7g} {z:.7g}" for x, y, z in np.asarray(mesh.vertices) * scale]
    lines += [f"vn {x:.4g} {y:.4g} {z:.4g}" for x, y, z in normals]
    if uv is not None:
        lines += [f"vt {u:.6f} {v:.6f}" for u, v in uv.reshape(-1, 2)]
    corners = zip(np.asarray(mesh.faces).ravel() + 1, index.reshape(-1) + 1, strict=True)
    corners = [
        f"{vertex}/{'' if uv is None else place}/{normal}"
        for place, (vertex, normal) in enumerate(corners, 1)
    ]
    lines += ["f " + " ".join(corners[i : i + 3]) for i in range(0, len(corners), 3)]
    return ("\n".join(lines) + "\n").encode()


def corner_normals(mesh: trimesh.Trimesh) -> np.ndarray:
    """Of each corner of each triangle [faces, 3, 3]: the mean of what meets there and is no farther
    turned than `CREASE`. Smooth where the surface is, and edges stay sharp, however the triangles
    lie: MuJoCo's own normals shade flat sides of machined parts.
    """
    _, place = np.unique(np.asarray(mesh.vertices), axis=0, return_inverse=True)
    corners = place.reshape(-1)[np.asarray(mesh.faces)]  # as one where seams of textures part them
    sides = np.asarray(mesh.face_normals)
    weights = np.asarray(mesh.face_angles)
    # All pairs of corners in one place, place by place.
    order = np.argsort(corners, axis=None, kind="stable")
    starts = np.flatnonzero(np.diff(corners.ravel()[order], prepend=-1))
    counts = np.diff(starts, append=order.size)
    one = np.repeat(order, np.repeat(counts, counts))
    within = np.arange(one.size) - np.repeat(np.cumsum(counts**2) - counts**2, counts**2)
    other = order[np.repeat(starts, counts**2) + within % np.repeat(counts, counts**2)]
    alike = (sides[one // 3] * sides[other // 3]).sum(1) > np.cos(np.deg2rad(CREASE))
    one, other = one[alike], other[alike]
    normals = np.zeros((corners.size, 3))
    np.add.at(normals, one, sides[other // 3] * weights.reshape(-1, 1)[other])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    unknown = lengths[:, 0] < 1e-9  # of triangles without area
    normals[unknown], lengths[unknown] = (0, 0, 1), 1
    return (normals / lengths).reshape(-1, 3, 3)


def points_in_front(rng: np.random.Generator, cameras: list[Camera], diameter: float):
    """Places for the part: points [n, 3] in the rig's frame (m), and how many cameras see each.

    Each lies in some camera's image, at a distance at which the part has one of `SIZES`.
    """
    points = np.empty((TRIES, 3))
    for n in range(TRIES):
        camera = cameras[rng.integers(len(cameras))]
        pixel = rng.uniform(0.1, 0.9, 2) * [camera.width, camera.height]
        side = min(camera.width, camera.height) * np.exp(rng.uniform(*np.log(SIZES)))
        depth = camera.k[0, 0] * diameter / side
        in_cam = np.linalg.inv(camera.k) @ [*pixel, 1] * depth
        points[n] = camera.cam_from_rig[:3, :3].T @ (in_cam - camera.cam_from_rig[:3, 3])
    return points, np.sum([sees(camera, points, diameter) for camera in cameras], 0)


def sees(camera: Camera, points: np.ndarray, diameter: float) -> np.ndarray:
    """Whether parts at `points` [n, 3] (rig frame, m) are wholly in the image, at a useful size."""
    in_cam = points @ camera.cam_from_rig[:3, :3].T + camera.cam_from_rig[:3, 3]
    z = np.maximum(in_cam[:, 2], 1e-6)
    pixels = in_cam[:, :2] / z[:, None] * np.diag(camera.k)[:2] + camera.k[:2, 2]
    size = camera.k[0, 0] * diameter / z
    low, high = np.array(SIZES) * min(camera.width, camera.height)
    inside = (pixels > 0.3 * size[:, None]) & (
        pixels < [camera.width, camera.height] - 0.3 * size[:, None]
    )
    return (in_cam[:, 2] > 0) & inside.all(1) & (size >= low * 0.99) & (size <= high * 1.01)


def check_rig(cameras: list[Camera], obj: Object, path):
    """Refuse a rig no two of whose cameras see the part together."""
    wanted = min(2, len(cameras))
    _, seen = points_in_front(np.random.default_rng(0), cameras, obj.diameter_m)
    if seen.max() < wanted:
        raise UserError(
            f"rig {path}: expected a place where {wanted} cameras see a part of "
            f"{obj.diameter_m * 1e3:.1f} mm at {SIZES[0]:.0%} to {SIZES[1]:.0%} of the image, got "
            "none; fix: check the units of the rig and of the mesh (--mesh-unit)"
        )


def place_rig(rng: np.random.Generator, cameras: list[Camera], diameter: float, target):
    """world_from_rig [4, 4] that has the part at `target` [3] (m) and cameras above the floor."""
    points, seen = points_in_front(rng, cameras, diameter)
    share = np.where(seen >= min(2, len(cameras)), seen.astype(float) ** 2, 0)
    if share.sum() == 0:
        return None
    point = points[rng.choice(len(points), p=share / share.sum())]
    centers = np.stack([np.linalg.inv(c.cam_from_rig)[:3, 3] for c in cameras])
    best, most = None, 0
    for _ in range(TRIES):
        turn = scenes.rotation_of(rng.normal(size=4))
        heights = ((centers - point) @ turn.T + target)[:, 2]
        above = int((heights > 0.3 * diameter).sum())
        if above > most:
            best, most = turn, above
        if above == len(cameras):
            break
    if best is None:
        return None
    world_from_rig = np.eye(4)
    world_from_rig[:3, :3], world_from_rig[:3, 3] = best, target - best @ point
    return world_from_rig


def views_of_scene(rng, gl, pool, kit: Kit, cameras: list[Camera], places=4):
    """One dropped scene through the rig; empty if too few cameras see enough of one part.

    returns: views, and the ids of the cameras that they are of
    """
    xml, fallen = kit.falling(rng)
    surrounded = rng.random() < SURROUNDED
    model, data = scenes.drop(rng, pool, lambda _: xml, kit.files, lit=not surrounded)
    light = _light(rng, model, pool, fallen) if surrounded else None
    model.vis.global_.offwidth = max(c.width for c in cameras)
    model.vis.global_.offheight = max(c.height for c in cameras)
    placed = []
    for part in fallen:
        world_from_obj = scenes.world_from_body(data, part.name)
        world_from_obj[:3, 3] /= kit.scale
        middle = (part.obj.bounds.max(0) + part.obj.bounds.min(0)) / 2
        target = world_from_obj[:3, :3] @ middle + world_from_obj[:3, 3]
        if np.linalg.norm(target[:2]) < 1.0 / kit.scale and target[2] > 0:
            placed.append((part, world_from_obj, target))  # else rolled away or sunk
    renderers = {}
    try:
        for _ in range(places if placed else 0):
            looked_at, _, target = placed[rng.integers(len(placed))]
            world_from_rig = place_rig(rng, cameras, looked_at.obj.diameter_m, target)
            if world_from_rig is None:
                continue
            views, names = [], []
            for camera in cameras:
                size = camera.width, camera.height
                if size not in renderers:
                    renderers[size] = Renderer(model, *size, gl, kit.near, kit.far(cameras))
                cam_from_world = camera.cam_from_rig @ np.linalg.inv(world_from_rig)
                renderer = renderers[size]
                view = _view(data, renderer, kit.scale, placed, camera, cam_from_world, light)
                if view is not None:
                    views.append(view)
                    names.append(camera.id)
            if len(views) >= min(2, len(cameras)):
                return views, names
        return [], []
    finally:
        for renderer in renderers.values():
            renderer.close()


def _light(rng: np.random.Generator, model, pool: list[bytes], fallen: list[Fallen]):
    """Light from one of the pictures of `pool`; parts of metal get its color."""
    encoded = np.frombuffer(pool[rng.integers(len(pool))], np.uint8)
    picture = cv2.imdecode(encoded, cv2.IMREAD_COLOR_RGB)
    around = shading.Surroundings(rng, picture, scenes.floor_color(model) ** GAMMA)
    materials = [shading.Material.random(rng, OTHER_METAL) for _ in range(model.ngeom)]
    for part in fallen:
        geom = model.geom(part.name)
        look = shading.Material.random(rng, METAL * (not part.printed))
        if look.metal is not None:
            model.mat_rgba[geom.matid[0], :3] = look.metal ** (1 / GAMMA)
        materials[geom.id] = look
    reach, deep = rng.uniform(*shading.REACH), rng.uniform(*shading.DEEP)
    return shading.Light(around, materials, reach, deep)


def _view(
    data, renderer, scale, placed, camera: Camera, cam_from_world, light: shading.Light | None
) -> View | None:
    in_scene = cam_from_world.copy()
    in_scene[:3, 3] *= scale
    if -(in_scene[:3, :3].T @ in_scene[:3, 3])[2] < 0.02:
        return None  # under the floor
    renderer.aim(data, camera.k, in_scene)
    ids, depth = renderer.geom_ids_depth()
    geoms = [renderer.model.geom(part.name).id for part, _, _ in placed]
    visible = [int((ids == geom).sum()) for geom in geoms]
    if max(visible) < LEAST_PIXELS:
        return None
    rgb, _ = renderer.rgb_depth()
    if light is not None:
        rgb = shading.lit(rgb, ids, depth, camera.k, in_scene, light)
    seen = []
    for (part, world_from_obj, _), geom in zip(placed, geoms, strict=True):
        mask = ids == geom
        corners = part.obj.bounds @ world_from_obj[:3, :3].T + world_from_obj[:3, 3]
        corners = corners @ cam_from_world[:3, :3].T + cam_from_world[:3, 3]
        if corners[:, 2].min() <= 0:
            continue
        pixels = corners @ camera.k.T
        pixels = pixels[:, :2] / pixels[:, 2:]
        if (pixels.max(0) < 0).any() or (pixels.min(0) > [camera.width, camera.height]).any():
            continue  # out of the image
        center = (pixels.min(0) + pixels.max(0)) / 2
        full = renderer.outline_pixels(data, camera.k, in_scene, center, geom)
        seen.append(Seen(part.obj, world_from_obj, mask, max(full, int(mask.sum()))))
    if not any(x.mask.sum() >= max(LEAST_VISIBLE * x.full_pixels, LEAST_PIXELS) for x in seen):
        return None
    # What else stands on the floor: not background either.
    other = (ids >= 0) & (ids != renderer.model.geom("floor").id) & ~np.isin(ids, geoms)
    return View(camera.k, cam_from_world, seen, rgb, depth / scale, other)


def scene_views(gl, rng, pool, kit: Kit, rig_of, drops: int = 200):
    """Drops scenes until a rig sees a part in one; see `views_of_scene`.

    rig_of  random numbers -> the cameras to look through
    """
    for _ in range(drops):
        views, names = views_of_scene(rng, gl, pool, kit, rig_of(rng))
        if views:
            return views, names
    raise UserError(
        f"parts {', '.join(part.obj.name for part in kit.parts)}: expected a scene in which the "
        f"rig sees at least {LEAST_VISIBLE:.0%} of one, got none in {drops}; "
        "fix: check the rig and the meshes' unit"
    )

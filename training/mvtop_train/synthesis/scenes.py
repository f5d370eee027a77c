"""Random scenes: the ball and distractors fall, then cameras are placed around the ball.

Paper, section 3: distractors fall with the ball; the hemispheres are massless, so that they do
not turn towards the ground; a camera is kept if exactly one hemisphere shows, by pixel counts
from a segmentation render.
"""

import cv2
import mujoco
import numpy as np

from ..data import backgrounds, mvball, objects
from ..data.rendered import Seen, View
from .render import GROUP, Renderer

WIDTH, HEIGHT = 640, 480
SHAPES = ("box", "sphere", "cylinder", "capsule", "ellipsoid")


def noise_texture(rng: np.random.Generator, size: int = 128) -> bytes:
    """PNG of smooth colored noise over several octaves."""
    image = np.zeros((size, size, 3), np.float32)
    for octave in (4, 8, 16, 32, 64):
        weight = rng.uniform(0, 1) / np.sqrt(octave)
        coarse = rng.uniform(-1, 1, (octave, octave, 3)).astype(np.float32)
        if rng.random() < 0.5:
            coarse = coarse.mean(2, keepdims=True).repeat(3, 2)
        image += weight * cv2.resize(coarse, (size, size), interpolation=cv2.INTER_CUBIC)
    image = rng.uniform(0, 255, 3) + image / np.abs(image).max() * rng.uniform(20, 160)
    return cv2.imencode(".png", image.clip(0, 255).astype(np.uint8))[1].tobytes()


class Photos:
    """Pictures of a folder, parts of which lie on floors and things."""

    def __init__(self, folder: str | None):
        self.paths = backgrounds.pictures(folder) if folder else []

    def __bool__(self):
        return bool(self.paths)

    def texture(self, rng: np.random.Generator, size: int = 512) -> bytes:
        picture = backgrounds.cut(self.paths, rng, size, size)
        return cv2.imencode(".png", picture[:, :, ::-1])[1].tobytes()


def row(values) -> str:
    return " ".join(f"{value:.3f}" for value in values)


def _random_quaternion(rng: np.random.Generator) -> np.ndarray:
    q = rng.normal(size=4)
    return q / np.linalg.norm(q)


def _textures(rng: np.random.Generator, pool: list[bytes]) -> tuple[str, dict[str, bytes], int]:
    """Six random 2-D textures as MJCF and their files."""
    parts, files = [], {}
    count = 6
    for i in range(count):
        kind = rng.choice(["noise", "checker", "gradient", "flat"], p=[0.6, 0.15, 0.15, 0.1])
        if kind == "noise":
            files[f"t{i}.png"] = pool[rng.integers(len(pool))]
            parts.append(f'<texture name="t{i}" type="2d" file="t{i}.png"/>')
        else:
            parts.append(
                f'<texture name="t{i}" type="2d" builtin="{kind}" width="64" height="64" '
                f'rgb1="{row(rng.random(3))}" rgb2="{row(rng.random(3))}"/>'
            )
        repeat = rng.uniform(0.5, 6)
        parts.append(
            f'<material name="m{i}" texture="t{i}" texrepeat="{repeat:.2f} {repeat:.2f}" '
            f'specular="{rng.uniform(0, 1):.2f}" shininess="{rng.uniform(0, 1):.2f}"/>'
        )
    return "\n".join(parts), files, count


def _distractor(rng: np.random.Generator, index: int, textures: int) -> str:
    shape = SHAPES[rng.integers(len(SHAPES))]
    size = row(rng.uniform(0.012, 0.055, 3))
    position = row([*rng.uniform(-0.28, 0.28, 2), 0.08 + 0.06 * index])
    if rng.random() < 0.5:
        look = f'material="m{rng.integers(textures)}"'
    else:
        look = f'rgba="{row(rng.random(3))} 1"'
    quaternion = row(_random_quaternion(rng))
    return (
        f'<body pos="{position}" quat="{quaternion}"><freejoint/>'
        f'<geom type="{shape}" size="{size}" density="600" {look}/></body>'
    )


def _ball(rng: np.random.Generator) -> str:
    shade = rng.uniform(0.9, 1.1)
    tint = {n: np.clip(np.array(c) * shade, 0, 1) for n, c in mvball.COLORS.items()}
    gloss = f'specular="{rng.uniform(0, 0.6):.2f}" shininess="{rng.uniform(0, 1):.2f}"'
    bumps = "".join(
        f'<geom name="{name}" type="sphere" size="{mvball.BUMP_RADIUS}" mass="0" group="{GROUP}" '
        f'pos="{row(axis * mvball.BUMP_CENTER)}" material="ball_{name}"/>'
        for name, axis in mvball.BUMPS.items()
    )
    position = row([*rng.uniform(-0.05, 0.05, 2), rng.uniform(0.1, 0.3)])
    materials = "".join(
        f'<material name="ball_{n}" rgba="{row(c)} 1" {gloss}/>' for n, c in tint.items()
    )
    body = (
        f'<body name="ball" pos="{position}" quat="{row(_random_quaternion(rng))}"><freejoint/>'
        f'<geom name="ball" type="sphere" size="{mvball.BALL_RADIUS}" mass="0.3" condim="6" '
        f'friction="1 0.05 0.02" material="ball_ball" group="{GROUP}"/>{bumps}</body>'
    )
    return f"<asset>{materials}</asset><worldbody>{body}</worldbody>"


def _lights(rng: np.random.Generator) -> str:
    lights = []
    count = rng.integers(1, 4)
    shadows = rng.random() < 0.5  # a shadow pass doubles the cost of a software render
    for i in range(count):
        angle, height = rng.uniform(0, 2 * np.pi), rng.uniform(0.8, 2.5)
        radius = rng.uniform(0, 2)
        color = np.clip(rng.uniform(0.3, 0.9) / np.sqrt(count) + rng.uniform(-0.08, 0.08, 3), 0, 1)
        position = np.array([radius * np.cos(angle), radius * np.sin(angle), height])
        lights.append(
            f'<light pos="{row(position)}" dir="{row(-position / np.linalg.norm(position))}" '
            f'diffuse="{row(color)}" specular="{row(color * rng.uniform(0, 1))}" '
            f'castshadow="{"true" if shadows and i == 0 else "false"}"/>'
        )
    return "".join(lights)


def drop(
    rng: np.random.Generator, pool: list[bytes], falling=_ball, assets=None, lit=True
) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """A scene after its objects have fallen.

    `falling(rng)` is the object's MJCF, `assets` the files that it needs. What is not `lit` has its
    own colors everywhere (`shading`).
    """
    textures, files, count = _textures(rng, pool)
    ambient = rng.uniform(0.1, 0.45) if lit else 1.0
    distractors = "".join(_distractor(rng, i, count) for i in range(rng.integers(3, 12)))
    floor = f'material="m{rng.integers(count)}"'
    xml = f"""<mujoco>
      <option timestep="0.003"/>
      <visual>
        <global offwidth="{WIDTH}" offheight="{HEIGHT}"/>
        <quality shadowsize="1024" offsamples="4" numslices="48" numstacks="32"/>
        <headlight ambient="{row([ambient] * 3)}" diffuse="{row([rng.uniform(0, 0.3) * lit] * 3)}"
                   specular="0 0 0"/>
      </visual>
      <asset>
        <texture type="skybox" builtin="gradient" width="64" height="384"
                 rgb1="{row(rng.random(3))}" rgb2="{row(rng.random(3))}"/>
        {textures}
      </asset>
      <worldbody>
        <geom name="floor" type="plane" size="4 4 0.1" {floor}/>
        {_lights(rng) if lit else ""}{distractors}
      </worldbody>
      {falling(rng)}
    </mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml, files | (assets or {}))
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, int(rng.integers(150, 400)))
    mujoco.mj_forward(model, data)
    return model, data


def floor_color(model: mujoco.MjModel) -> np.ndarray:
    """Mean color [3] of the floor's texture, 0 to 1, as its file has it."""
    material = model.geom("floor").matid[0]
    texture = model.mat_texid[material, mujoco.mjtTextureRole.mjTEXROLE_RGB.value]
    start, channels = model.tex_adr[texture], model.tex_nchannel[texture]
    count = model.tex_width[texture] * model.tex_height[texture] * channels
    texels = model.tex_data[start : start + count].reshape(-1, channels)
    return texels[:, :3].mean(0) / 255


def world_from_body(data: mujoco.MjData, name: str) -> np.ndarray:
    """Pose [4, 4] of a body, metres."""
    body = data.body(name)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = body.xmat.reshape(3, 3), body.xpos
    return pose


def random_camera(rng: np.random.Generator, target: np.ndarray, towards: np.ndarray):
    """A camera that sees `target` somewhere in its image, from about the direction `towards`.

    returns: k [3, 3], cam_from_world [4, 4]; None where it would be under the floor
    """
    # Cap in which the other hemisphere is hidden, with a margin for the segmentation to judge.
    axis = _random_in_cap(rng, towards, np.deg2rad(58))
    position = target + axis * rng.uniform(0.5, 1.0)
    if position[2] < 0.06:
        return None
    f = rng.uniform(560, 680)
    k = np.array([[f, 0, WIDTH / 2 - 0.5], [0, f, HEIGHT / 2 - 0.5], [0, 0, 1.0]])
    k[:2, 2] += rng.uniform(-10, 10, 2)
    pixel = np.array([rng.uniform(100, WIDTH - 100), rng.uniform(95, HEIGHT - 95), 1.0])
    ray = np.linalg.inv(k) @ pixel
    forward = -axis
    if abs(forward[2]) < 0.99:
        side = np.cross(forward, [0, 0, 1.0])
    else:  # straight down: what of x is across
        side = np.array([1.0, 0, 0]) - forward[0] * forward
    side /= np.linalg.norm(side)
    look = np.stack([side, np.cross(forward, side), forward])  # rows: camera axes in the world
    # Turn the camera so that the target lies on `ray`, then roll it.
    aim = _rotation_between(np.array([0, 0, 1.0]), ray / np.linalg.norm(ray))
    roll = cv2.Rodrigues(np.array([0, 0, np.deg2rad(rng.uniform(-30, 30))]))[0]
    pose = np.eye(4)
    pose[:3, :3] = aim @ roll @ look
    pose[:3, 3] = -pose[:3, :3] @ position
    return k, pose


def rotation_of(quaternion: np.ndarray) -> np.ndarray:
    """Rotation [3, 3] of (w, x, y, z), of any length but 0."""
    out = np.empty(9)
    mujoco.mju_quat2Mat(out, quaternion / np.linalg.norm(quaternion))
    return out.reshape(3, 3)


def _random_in_cap(rng: np.random.Generator, axis: np.ndarray, half_angle: float) -> np.ndarray:
    cos = rng.uniform(np.cos(half_angle), 1)
    azimuth = rng.uniform(0, 2 * np.pi)
    sin = np.sqrt(1 - cos**2)
    local = np.array([sin * np.cos(azimuth), sin * np.sin(azimuth), cos])
    return _rotation_between(np.array([0, 0, 1.0]), axis) @ local


def _rotation_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The smallest rotation that takes unit vector a to unit vector b."""
    cross, dot = np.cross(a, b), float(a @ b)
    if dot < -0.999999:
        return np.diag([1.0, -1.0, -1.0])
    skew = np.array([[0, -cross[2], cross[1]], [cross[2], 0, -cross[0]], [-cross[1], cross[0], 0]])
    return np.eye(3) + skew + skew @ skew / (1 + dot)


def cut_window(rng: np.random.Generator, k: np.ndarray, target: np.ndarray, size) -> np.ndarray:
    """Intrinsics of a `size` = (w, h) window of the full image that has pixel `target` inside."""
    full, size = np.array([WIDTH, HEIGHT]), np.array(size)
    start = np.round(target - rng.uniform(0.3, 0.7, 2) * size).clip(0, full - size)
    k = k.copy()
    k[:2, 2] -= start
    return k


def find_view(
    rng, data, renderer: Renderer, shows: str, min_pixels: int, tries: int
) -> View | None:
    """A camera in which only hemisphere `shows` is visible, with more than `min_pixels` pixels.

    `shows` "both": each of them is, so that one view determines the pose.
    If the renderer is smaller than the full image, the view is a window of it around the ball.
    """
    obj, world_from_obj = objects.ball(), world_from_body(data, "ball")
    wanted = list(mvball.BUMPS) if shows == "both" else [shows]
    hidden = [name for name in mvball.BUMPS if name not in wanted]
    # Opposite the hidden one, or between the two.
    axis = -mvball.BUMPS[hidden[0]] if hidden else sum(mvball.BUMPS.values()) / np.sqrt(2)
    towards = world_from_obj[:3, :3] @ axis
    ids = {name: renderer.model.geom(name).id for name in ("ball", "green", "red")}
    for _ in range(tries):
        camera = random_camera(rng, world_from_obj[:3, 3], towards)
        if camera is None:
            continue
        k, cam_from_world = camera
        pixel = k @ (cam_from_world @ world_from_obj)[:3, 3]
        k = cut_window(rng, k, pixel[:2] / pixel[2], (renderer.width, renderer.height))
        renderer.aim(data, k, cam_from_world)
        seg = renderer.geom_ids()
        bump_pixels = min(int((seg == ids[name]).sum()) for name in wanted)
        if bump_pixels <= min_pixels or any((seg == ids[name]).any() for name in hidden):
            continue
        mask = np.isin(seg, list(ids.values()))
        depth = (cam_from_world @ world_from_obj)[2, 3]
        full = np.pi * (k[0, 0] * mvball.BALL_RADIUS / depth) ** 2
        if mask.sum() < 0.5 * full:
            continue
        rgb, z = renderer.rgb_depth()
        center = k @ (cam_from_world @ world_from_obj)[:3, 3]
        full = renderer.outline_pixels(data, k, cam_from_world, center[:2] / center[2])
        seen = [Seen(obj, world_from_obj, mask, full, shows, bump_pixels)]
        return View(k, cam_from_world, seen, rgb, z)
    return None


def views_of_scene(
    rng, gl, pool, order: list[str], min_pixels: int, size=(WIDTH, HEIGHT), tries=12
) -> list[View]:
    """Drop one scene and find a view for each entry of `order`; empty if one cannot be found."""
    model, data = drop(rng, pool)
    ball = world_from_body(data, "ball")
    if np.linalg.norm(ball[:2, 3]) > 1.0 or ball[2, 3] < 0.02:
        return []  # rolled away, or was pushed into the floor
    for hidden in mvball.BUMPS:  # a camera opposite this hemisphere must be above the floor
        if -(ball[:3, :3] @ mvball.BUMPS[hidden])[2] < -0.6:
            return []
    renderer = Renderer(model, *size, gl)
    try:
        views = []
        for shows in order:
            view = find_view(rng, data, renderer, shows, min_pixels, tries)
            if view is None:
                return []
            views.append(view)
        return views
    finally:
        renderer.close()

"""Light from pictures of surroundings, for scenes whose renderer gave colors without light.

Diffuse light is summed over all directions; specular light is the split sum of Karis, "Real Shading
in Unreal Engine 4" (2013), with his fit of the environment's BRDF (2014). Nothing casts a shadow:
there is ambient occlusion, estimated from depth.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from ..data.color import GAMMA, LINEAR

WIDTH, HEIGHT = 256, 128  # px of surroundings: all azimuths, elevations from the top down
COARSE = 32, 16  # of those that diffuse light is summed over
ROUGHNESS = (0.0, 0.15, 0.3, 0.45, 0.6, 0.8, 1.0)  # of which blurred surroundings are kept
LOBE = 43  # px of blur for a roughness of 1, which grows with the square
NEUTRAL = 0.4, 1.0  # share of the light's color that cameras take out
LAMPS, LAMP_SIZE, LAMP_LIGHT = 4, (0.06, 0.6), (4, 60)  # at most; rad; times the mean light
EXPOSURE = 0.5, 0.4  # of a white floor: median, and deviation of the logarithm
DIELECTRIC = 0.04  # reflectance of paint and plastic, seen from above
REACH = 0.02, 0.06  # m of a scene's scale, in which neighbours take light
DEEP = 0.2, 0.8  # share of the light that they take at most
LEAVES = 1e3  # m, added to a step onto another thing
UP = np.array([[0.0, 0.0, 1.0]])
# Linear reflectance (Akenine-Moeller et al., Real-Time Rendering, table 9.2); cast and oxidised
# surfaces are estimates.
METALS = {
    "iron": (0.56, 0.57, 0.58), "aluminium": (0.91, 0.92, 0.92), "brass": (0.91, 0.78, 0.42),
    "copper": (0.96, 0.64, 0.54), "cast": (0.42, 0.41, 0.40), "oxidised": (0.08, 0.08, 0.09),
}  # fmt: skip


@dataclass(frozen=True)
class Material:
    """What a surface is made of: its linear reflectance [3] if it is metal, and its roughness, 0 to
    1."""

    metal: np.ndarray | None
    roughness: float

    @classmethod
    def random(cls, rng: np.random.Generator, metal: float) -> "Material":
        """Metal with the probability `metal`."""
        if rng.random() >= metal:
            return cls(None, rng.uniform(0.15, 1.0))
        color = np.array(list(METALS.values()))[rng.integers(len(METALS))]
        return cls(color * rng.uniform(0.6, 1.0), rng.uniform(0.05, 0.7))


@dataclass(frozen=True)
class Light:
    """What lights a scene, and what its geoms are made of, by their ids.

    - reach: m of the scene, in which neighbours take light
    - deep: share of it that they take at most
    """

    around: "Surroundings"
    materials: list[Material]
    reach: float
    deep: float


class Surroundings:
    """Light from all directions of a world whose z axis points up."""

    def __init__(self, rng: np.random.Generator, picture: np.ndarray, floor: np.ndarray):
        """
        - picture: [h, w, 3] uint8 of what stands around
        - floor: [3] 0 to 1, linear color of the floor
        """
        half = cv2.resize(picture, (WIDTH // 2, HEIGHT), interpolation=cv2.INTER_AREA)
        light = LINEAR[np.concatenate([half, half[:, ::-1]], 1)]
        light = np.roll(light, rng.integers(WIDTH), 1)
        for _ in range(rng.integers(0, LAMPS + 1)):
            light = np.maximum(light, _lamp(rng) * light.mean())
        below = _directions(WIDTH, HEIGHT)[..., 2] < 0
        light[below] = 0
        color = _diffuse(light, UP)[0].clip(1e-4)
        light *= (color.mean() / color) ** rng.uniform(*NEUTRAL) / color.mean()
        light *= np.exp(rng.normal(np.log(EXPOSURE[0]), EXPOSURE[1]))
        light[below] = floor * _diffuse(light, UP)[0]
        self._levels = [_blurred(light, LOBE * rough**2) for rough in ROUGHNESS]
        grid = _diffuse(light, _directions(*COARSE).reshape(-1, 3)).astype(np.float32)
        self._diffuse = grid.reshape(*COARSE[::-1], 3)

    def diffuse(self, normals: np.ndarray) -> np.ndarray:
        """What white paper shows of it, by its normal [h, w, 3]: [h, w, 3]."""
        return _looked_up([self._diffuse], normals, np.zeros(normals.shape[:2], int))

    def seen(self, directions: np.ndarray, roughness: np.ndarray) -> np.ndarray:
        """What comes from directions [h, w, 3], blurred by roughness [h, w]: [h, w, 3]."""
        between = np.diff(ROUGHNESS) / 2 + ROUGHNESS[:-1]
        return _looked_up(self._levels, directions, np.digitize(roughness, between))


def _directions(width: int, height: int) -> np.ndarray:
    """Of the pixels of surroundings [height, width, 3]."""
    azimuth = (np.arange(width) + 0.5) / width * 2 * np.pi
    elevation = np.pi / 2 - (np.arange(height)[:, None] + 0.5) / height * np.pi
    flat, up = np.cos(elevation), np.sin(elevation) + 0 * azimuth
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), up], -1)


def _lamp(rng: np.random.Generator) -> np.ndarray:
    """A lamp or a window [HEIGHT, WIDTH, 3] somewhere above, in multiples of the mean light."""
    size = np.exp(rng.uniform(*np.log(LAMP_SIZE), 2)) * [WIDTH / np.pi / 2, HEIGHT / np.pi]
    x, y = rng.uniform(0, WIDTH), rng.uniform(0, 0.45) * HEIGHT
    across = np.abs((np.arange(WIDTH) - x + WIDTH / 2) % WIDTH - WIDTH / 2) < size[0]
    along = np.abs(np.arange(HEIGHT) - y) < size[1]
    color = np.exp(rng.uniform(*np.log(LAMP_LIGHT))) * np.exp(rng.normal(0, 0.1, 3))
    return (along[:, None] & across)[..., None] * color.astype(np.float32)


def _diffuse(light: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Mean of the light [h, w, 3] by the cosine to normals [n, 3]: [n, 3]."""
    light = cv2.resize(light, COARSE, interpolation=cv2.INTER_AREA).reshape(-1, 3)
    directions = _directions(*COARSE)
    area = np.sqrt(1 - directions[..., 2] ** 2).ravel()
    weights = (normals @ directions.reshape(-1, 3).T).clip(0) * area
    return weights @ light / weights.sum(1, keepdims=True)


def _blurred(light: np.ndarray, sigma: float) -> np.ndarray:
    if sigma == 0:
        return light
    beside = min(int(3 * sigma) + 1, WIDTH)
    wide = np.concatenate([light[:, -beside:], light, light[:, :beside]], 1)
    wide = cv2.GaussianBlur(wide, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
    return wide[:, beside : beside + WIDTH]


def _looked_up(lights: list[np.ndarray], directions: np.ndarray, which: np.ndarray) -> np.ndarray:
    """Of lights [height, width, 3] of one size, `which` [h, w] in directions [h, w, 3]."""
    height, width = lights[0].shape[:2]
    x, y, z = np.moveaxis(directions.astype(np.float32), -1, 0)
    u = np.arctan2(y, x) % np.float32(2 * np.pi) * np.float32(width / 2 / np.pi) + np.float32(0.5)
    v = np.arccos(z.clip(-1, 1)) * np.float32(height / np.pi) - np.float32(0.5)
    out = np.zeros(directions.shape, np.float32)
    for level in np.unique(which):
        light = lights[level]
        wide = np.concatenate([light[:, -1:], light, light[:, :1]], 1)
        found = cv2.remap(wide, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        np.copyto(out, found, where=(which == level)[..., None])
    return out


def normals_of(points: np.ndarray, ids: np.ndarray) -> np.ndarray:
    """Normals [h, w, 3] of surfaces from their points [h, w, 3] in the camera's axes, towards the
    camera. Edges of one thing are rounded by a pixel, as those of parts are.

    ids  [h, w], which thing each point is of
    """
    across, along = _steps(points, ids, 1), _steps(points, ids, 0)
    normals = np.cross(across, along)
    normals *= np.where((normals * points).sum(-1, keepdims=True) > 0, -1, 1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True).clip(1e-12)
    total = normals.copy()
    for dy, dx in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        same = np.roll(ids, (dy, dx), (0, 1)) == ids
        total += np.roll(normals, (dy, dx), (0, 1)) * same[..., None]
    return total / np.linalg.norm(total, axis=-1, keepdims=True).clip(1e-12)


def _steps(points: np.ndarray, ids: np.ndarray, axis: int) -> np.ndarray:
    """From each point to the next or from the one before: what stays on the same thing, and changes
    its depth less."""
    step = np.diff(points, axis=axis)
    cost = np.abs(step[..., 2]) + LEAVES * (np.diff(ids, axis=axis) != 0)
    first, last = np.take(step, [0], axis), np.take(step, [-1], axis)
    far = np.full_like(np.take(cost, [0], axis), np.inf)
    after, before = np.concatenate([step, last], axis), np.concatenate([first, step], axis)
    cost_after, cost_before = np.concatenate([cost, far], axis), np.concatenate([far, cost], axis)
    np.copyto(before, after, where=(cost_after < cost_before)[..., None])
    return before


def occlusion(depth: np.ndarray, focal: float, reach: float) -> np.ndarray:
    """Share of the light [h, w] that neighbours take from what lies deeper than they do.

    - depth: [h, w] m
    - focal: px
    - reach: m
    """
    middle = float(np.median(depth))
    sigma = float(np.clip(focal * reach / middle, 1, 40))
    # The inverse of a plane's depth is linear: a plane hides nothing of itself.
    inverse = (1 / depth).astype(np.float32)
    beside = int(4 * sigma) + 1  # of a kernel
    wide = np.pad(inverse, beside, "reflect", reflect_type="odd")
    blurred = cv2.GaussianBlur(wide, (0, 0), sigma)[beside:-beside, beside:-beside]
    return ((blurred - inverse) * depth**2 / reach).clip(0, 1)


def lit(
    albedo: np.ndarray, ids: np.ndarray, depth: np.ndarray, k: np.ndarray,
    cam_from_world: np.ndarray, light: Light,
) -> np.ndarray:  # fmt: skip
    """The picture [h, w, 3] uint8 of a scene in its surroundings.

    - albedo: [h, w, 3] uint8, colors without light
    - ids: [h, w], of which of `light.materials` each pixel is; -1: of nothing, surroundings show
    - depth: [h, w] m
    """
    v, u = np.mgrid[: depth.shape[0], : depth.shape[1]]
    rays = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(k).T
    rays = rays.astype(np.float32)
    normals = normals_of(rays * depth[..., None].astype(np.float32), ids)
    world_from_cam = cam_from_world[:3, :3].T.astype(np.float32)
    view = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    facing = -(normals * view).sum(-1, keepdims=True)
    mirrored = (view + 2 * facing * normals) @ world_from_cam.T
    metal = np.array([one.metal is not None for one in light.materials])[ids][..., None]
    roughness = np.array([one.roughness for one in light.materials], np.float32)[ids]
    base = LINEAR[albedo]
    diffuse = light.around.diffuse(normals @ world_from_cam.T) * base * ~metal
    scale, offset = _environment_brdf(roughness[..., None], facing.clip(0, 1))
    specular = light.around.seen(mirrored, roughness)
    specular *= np.where(metal, base, np.float32(DIELECTRIC)) * scale + offset
    taken = light.deep * occlusion(depth, k[0, 0], light.reach)
    out = (diffuse + specular) * (1 - taken[..., None])
    if (ids < 0).any():
        behind = light.around.seen(view @ world_from_cam.T, 0 * roughness)
        np.copyto(out, behind, where=(ids < 0)[..., None])
    picture = (out.clip(0, 1) ** (1 / GAMMA) * 255).astype(np.uint8)
    return cv2.GaussianBlur(picture, (0, 0), 0.5)  # a pixel shows what is beside its middle, too


def _environment_brdf(roughness, facing) -> tuple[np.ndarray, np.ndarray]:
    """Factor of the reflectance, and what is added to it (Karis 2014)."""
    x, y, z, w = (
        roughness * slope + start
        for slope, start in ((-1, 1), (-0.0275, 0.0425), (-0.572, 1.04), (0.022, -0.04))
    )
    a = np.minimum(x * x, 2 ** (-9.28 * facing)) * x + y
    return -1.04 * a + z, 1.04 * a + w

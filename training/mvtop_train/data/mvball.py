"""The MV-ball object: a ball with two differently colored hemispheres 90 degrees apart.

Paper, section 3. Object frame: origin at the ball's center, the green hemisphere on +x, the red
one on +y. A view that shows only one hemisphere leaves the turn about it open.
"""

import numpy as np

OBJ_ID = 1
NAME = "mvball"
BALL_RADIUS = 0.060  # m
BUMP_RADIUS = 0.012  # m
# The base circle of each hemisphere lies on the ball.
BUMP_CENTER = float(np.sqrt(BALL_RADIUS**2 - BUMP_RADIUS**2))
BUMPS = {"green": np.array([1.0, 0.0, 0.0]), "red": np.array([0.0, 1.0, 0.0])}
COLORS = {"ball": (0.82, 0.82, 0.80), "green": (0.05, 0.55, 0.10), "red": (0.75, 0.05, 0.05)}
EXTENT = BUMP_CENTER + BUMP_RADIUS
# Farthest two points: from the top of one hemisphere to the ball's far side.
DIAMETER = EXTENT + BALL_RADIUS


def surface_points(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Points spread evenly over the visible surface.

    returns: points [n, 3] in metres (object frame), colors [n, 3] in 0..255
    """
    rng = np.random.default_rng(seed)
    kept: list[np.ndarray] = []
    colors: list[np.ndarray] = []
    parts = [("ball", np.zeros(3), BALL_RADIUS)]
    parts += [(name, axis * BUMP_CENTER, BUMP_RADIUS) for name, axis in BUMPS.items()]
    total_area = sum(radius**2 for _, _, radius in parts)
    for name, center, radius in parts:
        count = round(4 * n * radius**2 / total_area)
        points = rng.normal(size=(count, 3))
        points = center + radius * points / np.linalg.norm(points, axis=1, keepdims=True)
        outside = np.ones(count, bool)
        for other, other_center, other_radius in parts:
            if other != name:
                distance = np.linalg.norm(points - other_center, axis=1)
                outside &= distance >= other_radius
        kept.append(points[outside])
        colors.append(np.tile(np.array(COLORS[name]) * 255, (outside.sum(), 1)))
    points, color = np.concatenate(kept), np.concatenate(colors)
    # Hemispheres are small: keep all of their points, thin the ball.
    bump = np.linalg.norm(points, axis=1) > BALL_RADIUS * 1.001
    ball_index = rng.permutation(np.flatnonzero(~bump))[: n - bump.sum()]
    order = np.concatenate([np.flatnonzero(bump), ball_index])
    return points[order], color[order].round()


def bounding_points(n: int = 600) -> np.ndarray:
    """Points [m, 3] whose projections' extent is the amodal box, metres."""
    return surface_points(n, seed=1)[0]

"""Write `fixtures/metrics.safetensors`: errors of random poses as the BOP toolkit gives them.

    git clone https://github.com/thodan/bop_toolkit          # written with commit cea62d6
    export PYTHONPATH=training:bop_toolkit
    python -m mvtop_train.fixtures_metrics fixtures/metrics.safetensors
    python -m mvtop_train.fixtures_metrics --check

The toolkit need not be installed: only its `pose_error`, `misc`, `visibility` and `transform` are
used, which need NumPy and SciPy. `--check` compares the file with what the toolkit on the path
gives, and says so where there is none. Per case CASE, float64 unless noted, mm and px:

    CASE.points      [P, 3]     of the object, at random
    CASE.discrete    [D, 4, 4]  symmetries as in models_info.json
    CASE.axes        [C, 3]     continuous symmetries: axis, not normalised
    CASE.offsets     [C, 3]     and a point on it
    CASE.step        [1]        share of the diameter from one turn to the next
    CASE.symmetries  [S, 4, 4]  what the toolkit makes of them
    CASE.lens        [4]        fx fy cx cy
    CASE.truth       [N, 4, 4]  object frame to camera frame
    CASE.estimate    [N, 4, 4]
    CASE.add .adi .mssd .mspd .re .te           [N]
    CASE.re_symmetric .te_symmetric             [N]  least over the symmetries
    vsd.lens [4]  vsd.taus [T]  vsd.delta vsd.diameter  [1]
    vsd.estimate .truth .measured  [N, H, W]    float32, mm
    vsd.step .tlinear              [N, T]       as shares of the diameter
    vsd.step_mm                    [N, T]       taus times the diameter, not normalised
"""

import sys
from pathlib import Path

import numpy as np
from safetensors.numpy import load_file, save_file

SEED = 11
PATH = Path(__file__).parents[2] / "fixtures/metrics.safetensors"
TOLERANCE = 1e-9

# Name, points, discrete symmetries, continuous ones, largest error: degrees and mm.
CASES = [
    ("plain", 60, 0, 0, (20.0, 30.0)),
    ("far", 40, 0, 0, (180.0, 400.0)),
    ("discrete", 50, 3, 0, (180.0, 20.0)),
    ("continuous", 40, 0, 1, (180.0, 20.0)),
    ("both", 30, 1, 2, (180.0, 20.0)),
]
POSES = 12
VSD_POSES = 8
VSD_SIZE = (24, 32)


def rotation(rng, degrees=None):
    """[3, 3]: any rotation, or one by at most that angle."""
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    angle = np.radians(rng.uniform(0, 180 if degrees is None else degrees))
    cross = np.cross(np.eye(3), -axis)
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def pose(rotation, translation):
    return np.block([[rotation, np.reshape(translation, (3, 1))], [np.zeros((1, 3)), 1.0]])


def parts(motion):
    return motion[:3, :3], motion[:3, 3:]


def surface_case(rng, name, points, discrete, continuous, largest):
    from bop_toolkit_lib import misc, pose_error

    pts = rng.uniform(-60, 60, (points, 3)) * rng.uniform(0.3, 1, 3)
    syms = [pose(rotation(rng), rng.uniform(-5, 5, 3)) for _ in range(discrete)]
    axes, offsets = rng.normal(size=(continuous, 3)), rng.uniform(-8, 8, (continuous, 3))
    info = {
        "symmetries_discrete": [sym.ravel().tolist() for sym in syms],
        "symmetries_continuous": [
            {"axis": a.tolist(), "offset": o.tolist()} for a, o in zip(axes, offsets, strict=True)
        ],
    }
    # 0.01 gives 315 turns; a coarser step keeps the file small.
    step = 0.01 if continuous == 1 else 0.2
    symmetries = misc.get_symmetry_transformations(info, step)
    lens = np.array([*rng.uniform(500, 900, 2), *rng.uniform(200, 400, 2)])
    k = np.array([[lens[0], 0, lens[2]], [0, lens[1], lens[3]], [0, 0, 1]])
    truths, estimates, errors = [], [], []
    for _ in range(POSES):
        truth = pose(rotation(rng), [*rng.uniform(-200, 200, 2), rng.uniform(900, 1500)])
        near = pose(rotation(rng, largest[0]), rng.uniform(-largest[1], largest[1], 3))
        sym = symmetries[rng.integers(len(symmetries))]
        estimate = truth @ pose(sym["R"], sym["t"]) @ near
        t, e = parts(truth), parts(estimate)
        moved = [(t[0] @ s["R"], t[0] @ s["t"] + t[1]) for s in symmetries]
        truths.append(truth)
        estimates.append(estimate)
        errors.append(
            [
                pose_error.add(*e, *t, pts),
                pose_error.adi(*e, *t, pts),
                pose_error.mssd(*e, *t, pts, symmetries),
                pose_error.mspd(*e, *t, k, pts, symmetries),
                pose_error.re(e[0], t[0]),
                pose_error.te(e[1], t[1]),
                min(pose_error.re(e[0], r) for r, _ in moved),
                min(pose_error.te(e[1], x) for _, x in moved),
            ]
        )
    kinds = ["add", "adi", "mssd", "mspd", "re", "te", "re_symmetric", "te_symmetric"]
    tensors = {
        "points": pts,
        "discrete": np.array(syms).reshape(-1, 4, 4),
        "axes": axes,
        "offsets": offsets,
        "step": np.array([step]),
        "symmetries": np.array([pose(s["R"], s["t"]) for s in symmetries]),
        "lens": lens,
        "truth": np.array(truths),
        "estimate": np.array(estimates),
        **{kind: np.array(errors)[:, i].copy() for i, kind in enumerate(kinds)},
    }
    return {f"{name}.{key}": np.ascontiguousarray(value) for key, value in tensors.items()}


class Rendered:
    """In the renderer's place: depth images that are given."""

    def __init__(self, images):
        self.images = list(images)

    def render_object(self, *_):
        return {"depth": self.images.pop(0)}


def vsd_case(rng):
    from bop_toolkit_lib import pose_error

    height, width = VSD_SIZE
    lens = np.array([30.0, 32.0, 15.2, 11.7])
    k = np.array([[lens[0], 0, lens[2]], [0, lens[1], lens[3]], [0, 0, 1]])
    rays = np.stack(
        [
            (np.arange(width)[None] - lens[2]) / lens[0] + np.zeros((height, 1)),
            (np.arange(height)[:, None] - lens[3]) / lens[1] + np.zeros((1, width)),
            np.ones((height, width)),
        ],
        -1,
    )

    def sphere(center, radius):
        a, b = (rays**2).sum(-1), rays @ center
        root = b * b - a * (center @ center - radius**2)
        return np.where(root > 0, (b - np.sqrt(np.maximum(root, 0))) / a, 0)

    delta, diameter, taus = 15.0, 200.0, np.arange(0.05, 0.51, 0.05)
    images, results = {"estimate": [], "truth": [], "measured": []}, []
    for i in range(VSD_POSES):
        center = np.array([*rng.uniform(-60, 60, 2), rng.uniform(500, 600)])
        # The last estimate and truth are not in the image at all.
        off = rng.uniform(-40, 40, 3) if i < VSD_POSES - 1 else np.array([1e4, 0, 0])
        truth = sphere(center + (off if i == VSD_POSES - 1 else 0), diameter / 2)
        estimate = sphere(center + off, diameter / 2)
        # A wall, something before a part of it, holes, and noise as large as delta.
        scene = np.where(truth > 0, truth, 700.0)
        scene[:, : rng.integers(1, width // 2)] -= rng.uniform(0, 200)
        scene += rng.normal(0, 10, scene.shape)
        scene[rng.uniform(size=scene.shape) < 0.1] = 0
        truth, estimate, scene = (image.astype(np.float32) for image in (truth, estimate, scene))

        def vsd(taus, normalised, cost, est=estimate, gt=truth, test=scene):
            none = np.zeros((3, 3)), np.zeros((3, 1))
            renderer = Rendered([est, gt])
            return pose_error.vsd(
                *none, *none, test, k, delta, taus, normalised, diameter, renderer, 1, cost
            )

        for key, image in (("estimate", estimate), ("truth", truth), ("measured", scene)):
            images[key].append(image)
        results.append(
            [vsd(taus, True, "step"), vsd(taus, True, "tlinear"), vsd(taus * 200, False, "step")]
        )
    results = np.array(results)
    tensors = {
        "lens": lens,
        "taus": taus,
        "delta": np.array([delta]),
        "diameter": np.array([diameter]),
        **{key: np.array(value) for key, value in images.items()},
        **{key: results[:, i].copy() for i, key in enumerate(["step", "tlinear", "step_mm"])},
    }
    return {f"vsd.{key}": value for key, value in tensors.items()}


def fixture():
    rng = np.random.default_rng(SEED)
    tensors = {}
    for case in CASES:
        tensors |= surface_case(rng, *case)
    return tensors | vsd_case(rng)


def check():
    """Whether the toolkit still gives what the file says."""
    try:
        import bop_toolkit_lib.pose_error  # noqa: F401
    except ImportError as error:
        print(f"skipped: bop_toolkit is not on the path ({error})")
        return
    kept, now = load_file(PATH), fixture()
    if kept.keys() != now.keys():
        raise SystemExit(f"error: {PATH}: expected {sorted(now)}, got {sorted(kept)}")
    worst = max((np.abs(kept[name] - now[name]).max(initial=0), name) for name in now)
    if worst[0] > TOLERANCE:
        raise SystemExit(f"error: {PATH}: {worst[1]} is off by {worst[0]:.1e}; write it anew")
    print(f"{len(now)} arrays agree, the worst ({worst[1]}) to {worst[0]:.1e}")


def main(arguments):
    if arguments == ["--check"]:
        return check()
    save_file(fixture(), arguments[0], metadata={"numpy": np.__version__, "seed": str(SEED)})


if __name__ == "__main__":
    main(sys.argv[1:])

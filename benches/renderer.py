"""Our depth images and VSD beside the BOP toolkit's: python benches/renderer.py MODELS

Needs `make wheel; pip install target/wheels/mvtop-*.whl vispy PyOpenGL`, EGL
(`EGL_PLATFORM=surfaceless` without a screen), and the toolkit on the path
(PYTHONPATH=bop_toolkit). MODELS is a folder of a BOP data set with PLY meshes (models/,
models_eval/). Each object is put before the camera at random; depth images are rendered by both,
and VSD is computed from theirs by them and from ours by us, for estimates near and far.
"""

import argparse
import time
from pathlib import Path

import numpy as np
from bop_toolkit_lib import inout, pose_error
from bop_toolkit_lib.rendering import renderer_vispy

import mvtop
from mvtop import metrics

SEED = 7
WIDTH, HEIGHT = 640, 480
K = np.array([[1066.8, 0, 313.0], [0, 1067.5, 241.3], [0, 0, 1]])
POSES = 10
OFFSETS = (0.01, 0.05, 0.2)  # of estimates, diameters
DELTA = 15.0
TAUS = [round(0.05 * i, 2) for i in range(1, 11)]


def rotation(rng: np.random.Generator) -> np.ndarray:
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    return q * np.linalg.det(q)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("models", type=Path)
    folder = parser.parse_args().models
    rng = np.random.default_rng(SEED)
    theirs = renderer_vispy.RendererVispy(WIDTH, HEIGHT, mode="depth")
    camera = mvtop.Camera(K, (WIDTH, HEIGHT))
    pixels = outline = 0
    depth_off, vsd_off, ours_s, theirs_s = [], [], [], []
    for path in sorted(folder.glob("obj_*.ply")):
        number = int(path.stem[4:])
        ply = inout.load_ply(str(path))
        mesh = metrics.Mesh(ply["pts"], ply["faces"].astype(int).tolist())
        theirs.add_object(number, str(path))
        diameter = float(np.linalg.norm(np.ptp(ply["pts"], axis=0)))

        def rendered(pose, number=number, mesh=mesh):
            begin = time.perf_counter()
            images = theirs.render_object(
                number, pose[:3, :3], pose[:3, 3:], K[0, 0], K[1, 1], K[0, 2], K[1, 2]
            )
            middle = time.perf_counter()
            mine = mesh.depth(pose, camera, half_pixel=True)
            ours_s.append(time.perf_counter() - middle)
            theirs_s.append(middle - begin)
            return images["depth"], mine

        for _ in range(POSES):
            truth = np.eye(4)
            truth[:3, :3] = rotation(rng)
            truth[:3, 3] = [*rng.uniform(-50, 50, 2), rng.uniform(5, 9) * diameter]
            a, b = rendered(truth)
            pixels += int((a > 0).sum())
            outline += int(((a > 0) != (b > 0)).sum())
            both = (a > 0) & (b > 0)
            depth_off.append(np.abs(a - b)[both])
            for offset in OFFSETS:
                estimate = truth.copy()
                estimate[:3, 3] += offset * diameter * rotation(rng)[0]
                parts = [(p[:3, :3], p[:3, 3:]) for p in (estimate, truth)]
                measured = np.where(a > 0, a + rng.normal(0, 1, a.shape), 1.2 * a.max())
                measured = measured.astype(np.float32)
                expected = pose_error.vsd(
                    *parts[0], *parts[1], measured, K, DELTA, TAUS, True, diameter, theirs,
                    number, "step",
                )  # fmt: skip
                mine = metrics.vsd(
                    mesh.depth(estimate, camera, half_pixel=True), b, measured, camera,
                    delta=DELTA, taus=TAUS, diameter=diameter,
                )  # fmt: skip
                vsd_off.append(np.abs(np.array(expected) - mine).max())
    depth_off = np.concatenate(depth_off)
    print(f"{len(ours_s)} depth images, {pixels} pixels of theirs, {outline} of one side only")
    print(
        f"depth: 99.9 % within {np.percentile(depth_off, 99.9):.4f}, all {depth_off.max():.2f} mm"
    )
    print(f"VSD: {len(vsd_off)} poses, greatest difference {max(vsd_off):.5f}")
    times = 1e3 * np.median(theirs_s), 1e3 * np.median(ours_s)
    print(f"ms per image (median): theirs {times[0]:.1f}, ours {times[1]:.1f}")


if __name__ == "__main__":
    main()

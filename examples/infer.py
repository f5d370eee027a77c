"""Poses in the shipped example: python examples/infer.py"""

from pathlib import Path

import mvtop

ROOT = Path(__file__).resolve().parents[1]

rig = mvtop.Rig.load(ROOT / "examples/mvball/rig.json")
estimator = mvtop.Estimator.load("mvball")
images = {camera.id: ROOT / f"examples/mvball/{camera.id}.png" for camera in rig.cameras}
prediction = estimator.predict(images, rig)
for found in prediction:
    print(f"{found.class_name}, expected to be off by {found.sigma.rot_deg:.1f} degrees")
    print(found.ref_from_obj.round(4))

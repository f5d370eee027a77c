"""Several groups of images at once, and what of the answers is sure: python examples/several.py"""

import mvtop

rig, images = mvtop.example()
estimator = mvtop.Estimator.load("mvball")
both, left = estimator.predict([images, dict(list(images.items())[:1])], rig)
for name, prediction in (("both views", both), ("one view", left)):
    sure = prediction[[found.sigma.rot_deg < 10 for found in prediction]]
    print(f"{name}: {len(prediction)} found, {len(sure)} known to 10 degrees")
    print(sure.poses.round(4))

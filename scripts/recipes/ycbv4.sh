#!/usr/bin/env bash
# The last stages of the training of models/ycbv4; MESHES is the folder of YCB-V's meshes. `restore`
# starts from a bundle of this repository; the first one was trained by `--config ycbv4`. Object
# coordinates were trained on by configs of commit 46fb0b7.
set -euo pipefail
cd "$(dirname "$0")/../.."
: "${MESHES:?expected the folder of obj_000002.obj and others}"
parts=(--mesh-unit mm --backgrounds data/backgrounds)
for part in 2:cracker_box 4:soup_can 5:mustard_bottle 9:potted_meat_can; do
  parts+=(--mesh "$MESHES/obj_00000${part%%:*}.obj" --name "${part#*:}" --id "${part%%:*}")
done

mvtop-train generate --out data/ycbv4 --split train --scenes 3690 "${parts[@]}"
mvtop-train restore --bundle models/ycbv4 --data data/ycbv4 --out runs/ycbv4-shipped/weights.pt
mvtop-train generate --out data/ycbv4r --seed 7 --split train --scenes 600 "${parts[@]}"
mvtop-train train --config ycbv4-boxes --out runs/ycbv4-det --set data=data/ycbv4r \
    --set minutes=45 --set warmup=60
mvtop-train export --weights runs/ycbv4-det/weights.pt --data data/ycbv4r --bits 8 --integers --out models/ycbv4 \
    --score-threshold 0.242 --agree-threshold 0.242
mvtop-train run --out runs/ycbv4 "${parts[@]}" --minutes 40 --set init=models/ycbv4 --set occluders=0.3
cp runs/ycbv4/bundle/* models/ycbv4/
mvtop-train generate --out data/ycbv4c --seed 5 --split train --scenes 240 "${parts[@]}"
mvtop-train calibrate --bundle models/ycbv4 --data data/ycbv4c --held-out 240

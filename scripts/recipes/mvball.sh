#!/usr/bin/env bash
# The last stages of the training of models/mvball. The weights are not reproduced bit by bit, as
# earlier stages were resumed with changed settings.
set -euo pipefail
cd "$(dirname "$0")/../.."

mkdir -p runs && git show 657d909:models/mvball.weights.pt > runs/mvball.pt
scripts/get-backgrounds.sh data/backgrounds
mvtop-train generate --out data/mvball --scenes 4210 --seed 1 --window 320
mvtop-train train --config small-cpu --out runs/ball --set init=runs/mvball.pt \
  --set backgrounds=data/backgrounds --set minutes=36 --set lr=7e-4 --set warmup=200 --set network.hypotheses=6
mvtop-train train --config hypotheses-cpu --out runs/ball-poses --set init=runs/ball/weights.pt \
  --set backbone=runs/ball/weights.pt --set backgrounds=data/backgrounds --set copies=3 --set minutes=29 --set lr=1e-3 --set warmup=100
mkdir runs/ball-more && mv runs/ball-poses/features runs/ball-more
mvtop-train train --config hypotheses-cpu --out runs/ball-more --set init=runs/ball-poses/weights.pt \
  --set backbone=runs/ball/weights.pt --set backgrounds=data/backgrounds --set copies=3 --set minutes=42 --set lr=1e-3 --set warmup=100
mvtop-train export --weights runs/ball-more/weights.pt --out models/mvball --data data/mvball --bits 8 --integers --score-threshold 0.75 --agree-threshold 0.5
mvtop-train generate --out data/held --scenes 300 --seed 2 --window 320
mvtop-train calibrate --bundle models/mvball --data data/held --held-out 300

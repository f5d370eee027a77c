#!/usr/bin/env bash
# Installs a wheel, with what it declares and nothing else, and runs the README's Python lines: they must find
# the ball where it is. In an empty folder the command has all that it needs.
set -euo pipefail
if [ $# != 1 ]; then
  echo "error: expected one wheel, got $#: $*; fix: remove those that are not to be tried" >&2
  exit 1
fi
wheel=$(realpath "$1")
cd "$(dirname "$0")/.."
venv=$(mktemp -d)
trap 'rm -rf "$venv"' EXIT
unset PYTHONPATH ORT_DYLIB_PATH VIRTUAL_ENV
python3 -m venv "$venv"
"$venv/bin/pip" install --quiet --disable-pip-version-check "$wheel"
sed -n '/^```python$/,/^```$/{//!p}' README.md >"$venv/readme.py"
cat >>"$venv/readme.py" <<'END'
import json

truth = json.load(open("examples/mvball/truth.json"))["objects"][0]["T_world_obj"]
off = mvtop.metrics.rotation_error_deg(truth, prediction.objects[0].world_from_obj)
assert off < 10, f"the ball's pose is {off:.1f} degrees off"
END
"$venv/bin/python" "$venv/readme.py"
mkdir "$venv/empty"
(cd "$venv/empty" && "$venv/bin/mvtop-cli" infer --example && "$venv/bin/mvtop-cli" doctor)
"$venv/bin/mvtop-cli" infer --rig examples/mvball/rig.json examples/mvball/*.png

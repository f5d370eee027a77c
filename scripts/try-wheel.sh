#!/usr/bin/env bash
# Installs a wheel, with what it declares and nothing else, and runs the README's Python lines.
set -euo pipefail
wheel=$(realpath "$1")
cd "$(dirname "$0")/.."
venv=$(mktemp -d)
trap 'rm -rf "$venv"' EXIT
unset PYTHONPATH ORT_DYLIB_PATH VIRTUAL_ENV
python3 -m venv "$venv"
"$venv/bin/pip" install --quiet --disable-pip-version-check "$wheel"
sed -n '/^```python$/,/^```$/{//!p}' README.md >"$venv/readme.py"
"$venv/bin/python" "$venv/readme.py" | tee "$venv/printed"
grep -q mvball "$venv/printed" # the ball was found
"$venv/bin/mvtop-cli" infer --rig examples/mvball/rig.json examples/mvball/*.png

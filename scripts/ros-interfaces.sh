#!/usr/bin/env bash
# Builds the message packages named into an environment of ROS 2's Python wheels: VENV PACKAGE...
set -euo pipefail

venv=$(realpath "$1")
python=$venv/bin/python
headers=$("$python" -c 'import sysconfig; print(sysconfig.get_path("include"))')
numpy=$("$python" -c 'import numpy; print(numpy.get_include())')
version=$("$python" -c 'import sys; print(f"{sys.version_info.major}.{sys.version_info.minor}")')

# The wheels name the headers of the machine that built them.
{ grep -rlI /opt/python/cp "$venv"/share/*/cmake || true; } | xargs --no-run-if-empty sed -i -E \
  -e "s#/opt/python/cp[0-9]+-cp[0-9]+/include/python[0-9.]+#$headers#g" \
  -e "s#/opt/python/cp[0-9]+-cp[0-9]+/lib/python[0-9.]+/site-packages/numpy/_core/include#$numpy#g"

shift
for package; do
  build=$(mktemp -d)
  if ! { PATH="$venv/bin:$PATH" cmake -S "$package" -B "$build" -Wno-dev \
      -DCMAKE_BUILD_TYPE=Release -DBUILD_TESTING=OFF -DPython3_EXECUTABLE="$python" \
      -DCMAKE_PREFIX_PATH="$venv" -DCMAKE_INSTALL_PREFIX="$venv" \
      -DPYTHON_INSTALL_DIR="lib/python$version/site-packages" &&
      cmake --build "$build" --target install --parallel; } >"$build/log" 2>&1; then
    cat "$build/log" >&2
    exit 1
  fi
  rm -rf "$build"
done

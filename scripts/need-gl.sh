#!/usr/bin/env bash
# Rendering needs an off-screen OpenGL: install it where we may, else say what to install.
set -euo pipefail
PATH="$PATH:/usr/sbin:/sbin" # where ldconfig is, which Debian's users do not look in
packages="libegl1 libgl1-mesa-dri libopengl0"
ldconfig -p | grep -q 'libEGL\.so\.1' && ldconfig -p | grep -q 'libOpenGL\.so\.0' && exit 0
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
  apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq $packages >/dev/null
else
  echo "error: rendering needs off-screen OpenGL, which is not installed; fix: sudo apt-get install $packages" >&2
  exit 1
fi

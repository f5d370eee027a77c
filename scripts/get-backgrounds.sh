#!/usr/bin/env bash
# Some hundred free photographs and drawings to train before, from Debian's wallpaper packages:
#   scripts/get-backgrounds.sh data/backgrounds
# Pictures of the empty cell, by the rig's own cameras, are better. Needs apt-get and dpkg-deb.
set -euo pipefail
out=$(realpath -m "${1:?usage: scripts/get-backgrounds.sh FOLDER}")
packages="gnome-backgrounds lomiri-wallpapers-16.04 lomiri-wallpapers-20.04 mate-backgrounds
  plasma-workspace-wallpapers ukui-wallpapers"
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
chmod 755 "$work"
cd "$work"
apt-get download -qq $packages
for package in *.deb; do dpkg-deb -x "$package" unpacked; done
mkdir -p "$out"
# Small files are thumbnails and links; the same picture comes in many sizes: one of each is enough.
find unpacked -type f -size +60k \( -name '*.jpg' -o -name '*.png' -o -name '*.webp' \) \
  ! -name 'screenshot*' -print0 | sort -z | while IFS= read -r -d '' picture; do
  name=$(echo "${picture#unpacked/usr/share/}" | sed 's|/contents/images/[^/]*\.|.|; s|/|-|g')
  [ -e "$out/$name" ] || cp "$picture" "$out/$name"
done
echo "$out: $(ls "$out" | wc -l) pictures; their licences: apt show PACKAGE"

#!/usr/bin/env bash
# The page is tested in Chromium: install it where we may, else say what to install.
set -euo pipefail
command -v chromium >/dev/null && exit 0
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
  apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq chromium >/dev/null
else
  echo "error: the page is tested in Chromium, which is not installed; fix: sudo apt-get install chromium" >&2
  exit 1
fi

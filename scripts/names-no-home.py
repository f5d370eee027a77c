#!/usr/bin/env python3
"""Refuses a wheel in which the home of its builder is named: names-no-home.py WHEEL"""

import sys
import zipfile
from pathlib import Path

home = str(Path.home()).encode() + b"/"
with zipfile.ZipFile(sys.argv[1]) as wheel:
    for name in wheel.namelist():
        if count := wheel.read(name).count(home):
            sys.exit(
                f"{sys.argv[1]}: {name} names {home.decode()} {count} times, expected never; build it with "
                "`make release-wheel`"
            )

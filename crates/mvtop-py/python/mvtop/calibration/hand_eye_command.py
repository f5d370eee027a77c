from __future__ import annotations
def add(commands, formatter):
    pass

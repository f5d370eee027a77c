"""How far views may be apart before a calibration is doubted."""

from pathlib import Path

import numpy as np

from mvtop_train.data import bop
from mvtop_train.training import deviation


def test_a_hundredth_is_warned_of():
    found = [*np.linspace(0, 0.995, 198), 7.0, 9.0]
    # Two of 200.
    assert deviation.choose(found) == 1.0
    assert deviation.choose(found[:199]) == 1.0  # one of 199
    assert deviation.choose(found[-99:]) == 9.0  # none of 99
    # Too few to tell.
    assert deviation.choose([1.0] * 19) is None
    # Views that always agree exactly are no reason to warn of rounding.
    assert deviation.choose([0.0] * 50) == 0.1


def test_groups_are_of_two_and_of_three_and_of_one_scene_each():
    def scene(name, count):
        path = Path(name)
        return [bop.Image(n, path / f"{n}.png", np.eye(3), np.eye(4), []) for n in range(count)]

    groups = deviation.groups_of([scene("a", 5), scene("b", 1)])
    assert [[one.number for one in group] for group in groups] == [[0, 1], [2, 3], [0, 1, 2]]

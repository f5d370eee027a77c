"""How far images must look like what is printed on an object."""

import json

from mvtop_train.training import prints
from mvtop_train.training.confidence import Judged


def judged(likeness: float, right: bool = True) -> Judged:
    return Judged({"print": likeness}, right, None, 2, False)


def test_a_hundredth_of_the_right_poses_is_lost_whatever_wrong_ones_look_like():
    found = [judged(0.2 + n / 1000) for n in range(100)]
    wrong = [judged(-0.1, right=False)] * 50
    assert prints.choose(wrong + found[::-1]) == 0.201
    kept = prints.kept(wrong + found, 0.201)
    assert len(kept) == 99 and all(one.right for one in kept)


def test_parts_without_print_say_nothing_and_are_kept():
    plain = [judged(0.0)] * 200
    assert prints.choose(plain) is None
    assert prints.choose(plain + [judged(0.4)] * (prints.FEWEST - 1)) is None
    assert prints.choose(plain + [judged(0.4)] * prints.FEWEST) == 0.4
    assert prints.kept(plain, 0.3) == plain
    assert prints.kept([judged(0.1)], None) == [judged(0.1)]


def test_it_is_written_into_the_bundle_and_taken_out(tmp_path):
    description = {"detector": {"nms_iou": 0.5}, "classes": []}
    (tmp_path / "model.json").write_text(json.dumps(description))
    read = lambda: json.loads((tmp_path / "model.json").read_text())  # noqa: E731
    prints.add(tmp_path, 0.15)
    assert read() == {"detector": {"nms_iou": 0.5, "print_threshold": 0.15}, "classes": []}
    prints.add(tmp_path, None)
    assert read() == description

"""Text from outside in what this package says: nothing in it shows something else than it holds."""

import ast
from pathlib import Path

import pytest

import mvtop
from mvtop._printable import harmless, printable

PACKAGE = Path(mvtop.__file__).parent
OUTSIDE = "\x1b]0;pwn\x07\u202e\u009b31m\u200b\u2028\u061c\ufeff\U000e0041"
SHOWN = r"\u001b]0;pwn\u0007\u202e\u009b31m\u200b \u061c\ufeff\udb40\udc41"  # U+2028 ends a line


@pytest.mark.parametrize(
    "refuse",
    [
        lambda estimator, rig, paths: estimator.predict({OUTSIDE: paths[0]}, rig),
        lambda estimator, rig, paths: estimator.predict([paths[0], OUTSIDE], rig),
        lambda estimator, rig, paths: estimator.predict(paths, rig, boxes=[{OUTSIDE: 1}]),
        lambda estimator, rig, paths: estimator.predict(paths, rig, boxes=[[OUTSIDE]]),
        lambda estimator, rig, paths: estimator.predict(paths, rig).filter(class_name=OUTSIDE),
        lambda estimator, rig, paths: mvtop.Request(polygons={OUTSIDE: 1}),
        lambda estimator, rig, paths: mvtop.Tracker(estimator, rig).remove(OUTSIDE),
    ],
    ids=["camera", "file", "boxes", "box", "class", "polygon", "tracker"],
)
@pytest.mark.filterwarnings("ignore::mvtop.MvtopWarning")
def test_names_that_mislead_a_terminal_are_escaped(refuse, estimator, rig, paths):
    with pytest.raises(ValueError) as raised:
        refuse(estimator, rig, paths)
    assert str(raised.value).isprintable()


def test_a_name_is_shown_as_json_has_it():
    assert printable(OUTSIDE) == SHOWN
    assert harmless("a\nb\u2028\U000e0041 Größe 球") == "a\nb\\u2028\\udb40\\udc41 Größe 球"


def test_every_sentence_with_values_is_made_by_the_one_helper():
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "ValueError":
                raw = [part for part in ast.walk(node) if isinstance(part, ast.FormattedValue)]
                assert not raw, f"{path}:{node.lineno}"

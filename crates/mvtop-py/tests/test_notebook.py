"""The notebook runs from top to bottom, and what it shows is so."""

import json

import nbformat
from conftest import ROOT
from nbclient import NotebookClient

TRUTH = ROOT / "examples/mvball/truth.json"
# Run below the notebook's own cells, with their variables.
ERRORS = f"""
import json
truth = json.loads(Path({str(TRUTH)!r}).read_text())["objects"][0]["T_world_obj"]
poses = [found.world_from_obj for found in (ball, guess)]
print([float(mvtop.metrics.rotation_error_deg(truth, pose)) for pose in poses])
"""


def test_notebook_finds_the_ball_better_in_two_views_than_in_one():
    notebook = nbformat.read(ROOT / "examples/mvball.ipynb", as_version=4)
    notebook.cells.append(nbformat.v4.new_code_cell(ERRORS))
    resources = {"metadata": {"path": str(ROOT / "examples")}}
    NotebookClient(notebook, timeout=300, kernel_name="python3", resources=resources).execute()
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    outputs = [output for cell in cells for output in cell.outputs]
    assert not any(output.output_type == "error" for output in outputs)
    two_views, one_view = json.loads(cells[-1].outputs[0].text)
    assert two_views < 10 and two_views < one_view / 2
    pictures = [o for o in outputs if "image/png" in o.get("data", {})]
    assert len(pictures) == 2

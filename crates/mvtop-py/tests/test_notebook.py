"""The notebook runs from top to bottom."""

import nbformat
from conftest import ROOT
from nbclient import NotebookClient


def test_notebook_finds_the_ball_better_in_two_views_than_in_one():
    notebook = nbformat.read(ROOT / "examples/mvball.ipynb", as_version=4)
    resources = {"metadata": {"path": str(ROOT / "examples")}}
    NotebookClient(notebook, timeout=300, kernel_name="python3", resources=resources).execute()
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    outputs = [output for cell in cells for output in cell.outputs]
    assert not any(output.output_type == "error" for output in outputs)
    printed = "".join(output.text for output in outputs if output.output_type == "stream")
    both, one = (
        float(line.split("off by ")[1].split()[0])
        for line in printed.splitlines()
        if "off by" in line
    )
    assert both < one
    pictures = [o for o in outputs if "image/png" in o.get("data", {})]
    assert len(pictures) == 2

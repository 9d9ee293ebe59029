"""Every notebook runs from its first to its last cell, asserts included, and is stored without outputs."""

import os
import re
from pathlib import Path

import pytest

from tests.effort import environment_of_users

nbformat = pytest.importorskip("nbformat")
nbclient = pytest.importorskip("nbclient")
pytest.importorskip("ipykernel")

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
SLOW = {
    "01_cost_landscape",
    "02_initialization",
    "03_jacobians",
    "04_tracking",
    "05_learning_through_the_solver",
    "06_self_calibration",
}
SLOW |= {"07_uncertainty_and_integrity", "08_localizability", "09_roofline", "10_explain_the_pose"}
SLOW |= {
    "11_a_map_from_a_drive",
    "12_loops",
    "13_a_living_map",
    "14_surround_view",
    "15_parking",
    "16_no_wheels",
    "17_eyes_from_a_map",
}
"""Half a minute and more, most of it compilation; the roofline measures, which wants a machine of its own."""
AS_FOR_USERS = SLOW | {"00_quickstart"}
"""Run programs compiled with the effort that users get; the others with that of the tests, see `tests/effort.py`."""
RUN = [pytest.param(path, marks=[pytest.mark.slow] if path.stem in SLOW else [], id=path.stem) for path in NOTEBOOKS]


def code_cells(path):
    return [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]


def test_there_are_notebooks():
    assert len(NOTEBOOKS) >= 4


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_stored_without_outputs(path):
    cells = code_cells(path)
    assert not [cell.source for cell in cells if cell.outputs or cell.execution_count is not None]
    assert "assert" in cells[-1].source


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_the_page_of_the_notebooks_shows_it(path):
    """`python .ci/gallery.py NAME` draws it."""
    title = nbformat.read(path, as_version=4).cells[0].source.partition("\n")[0].lstrip("# ")
    page = (path.parent / "README.md").read_text(encoding="utf-8")
    assert f"[{title}]({path.name})" in page and f"(pictures/{path.stem}.jpg)" in page


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_cells_fit_on_a_screen(path):
    lengths = {cell.source.splitlines()[0]: len([line for line in cell.source.splitlines() if line.strip()])
               for cell in code_cells(path)}  # fmt: skip
    assert not {first: length for first, length in lengths.items() if length > 15}


def test_notebooks_use_the_doors_of_few_rooms():
    sources = "\n".join(cell.source for path in NOTEBOOKS for cell in code_cells(path))
    used = set(re.findall(r"^(?:from|import) (semloc_jax\S*)", sources, re.MULTILINE))
    assert not [name for name in used if name.count(".") > 1], "a name behind the door of a room"
    assert len(used - {"semloc_jax"}) <= 12


@pytest.mark.parametrize("path", RUN)
def test_runs(path, tmp_path):
    notebook = nbformat.read(path, as_version=4)
    python_path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    environment = environment_of_users() if path.stem in AS_FOR_USERS else dict(os.environ)
    environment |= {"JAX_PLATFORMS": "cpu", "PYTHONPATH": python_path}
    client = nbclient.NotebookClient(
        notebook, timeout=300, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}
    )
    # A cell that raises, a failed assert among them, ends the run with CellExecutionError.
    client.execute(env=environment)
    assert list(tmp_path.iterdir()) == [], "a notebook leaves nothing beside it"

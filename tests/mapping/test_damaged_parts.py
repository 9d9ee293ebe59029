"""Parts of an unfinished map that are damaged, or of another map, are refused in one line."""

import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.mapping.evidence_grid import TILE, EvidenceGrid
from semloc_jax.mapping.looking import Gatherer
from semloc_jax.mapping.parts import Parts
from semloc_jax.mapping.sightings import COLUMNS, Sightings
from semloc_jax.perception import load_class_table
from semloc_jax.storage import write_npz

TABLE = load_class_table("drive")


@pytest.mark.parametrize("name", ["rows", "1_2", "1_2_3_4", "a_b_c"])
def test_tiles_have_a_place(tmp_path, name):
    write_npz(tmp_path / "part.npz", {name: np.zeros((TILE, TILE), np.float32)})
    with pytest.raises(SemlocError, match="part of a map"):
        EvidenceGrid(0.5).attach(tmp_path / "part.npz")


@pytest.mark.parametrize("values", [np.zeros((3, TILE), np.float32), np.zeros((TILE, TILE)), np.float32(1.0)])
def test_tiles_have_a_size(tmp_path, values):
    write_npz(tmp_path / "part.npz", {"0_0_0": values})
    grid = EvidenceGrid(0.5)
    grid.attach(tmp_path / "part.npz")
    with pytest.raises(SemlocError, match="0_0_0 is no tile; begin anew"):
        grid.plane(0, np.array([0, 0]), np.array([5, 5]))


@pytest.mark.parametrize(
    "arrays",
    [
        {},
        {"rows": np.zeros(3)},
        {"rows": np.zeros((2, len(COLUMNS) - 1))},
        {"rows": np.zeros((2, len(COLUMNS)), np.int8)},
    ],
)
def test_sightings_have_columns(tmp_path, arrays):
    write_npz(tmp_path / "part.npz", arrays)
    with pytest.raises(SemlocError, match="holds no sightings; begin anew"):
        Sightings(TABLE).attach(tmp_path / "part.npz")


def test_a_part_that_is_gone_is_missed(tmp_path):
    for count in (80, 100):
        write_npz(tmp_path / f"looks_{count:06d}", {})
    with pytest.raises(SemlocError, match="2 parts of 100 frames; some are gone: begin anew"):
        Parts(tmp_path).gathered(Gatherer(TABLE, 0.5), range(100))

"""`semloc data` makes the drives of the tables, leaves whole ones alone, finishes broken ones, overwrites nothing."""

from dataclasses import replace

import pytest

from semloc_jax.cli.main import FAILED, OK, main
from semloc_jax.simulation import SimulationConfig, named_drives


@pytest.fixture
def tiny(monkeypatch):
    """One drive in the list, of one small frame."""
    config = SimulationConfig(num_frames=1, width_px=96, height_px=60, has_images=False)
    made = replace(named_drives.NAMED_DRIVES["road"], config=config)
    monkeypatch.setattr(named_drives, "NAMED_DRIVES", {"road": made})


def test_a_drive_is_made_once(tiny, tmp_path, capsys):
    assert main(["data", "road", "--out", str(tmp_path)]) == OK
    assert "1 frames, cameras front" in capsys.readouterr().out
    mask = tmp_path / "road" / "sem" / "front" / "000000.png"
    first = mask.stat().st_mtime_ns
    assert main(["data", "all", "--out", str(tmp_path)]) == OK
    assert mask.stat().st_mtime_ns == first
    (tmp_path / "road" / "recipe.txt").write_text("not finished\n")  # killed half way
    assert main(["data", "road", "--out", str(tmp_path)]) == OK
    assert mask.stat().st_mtime_ns > first


def test_other_folders_and_names_are_refused(tiny, tmp_path, capsys):
    (tmp_path / "road").mkdir()
    (tmp_path / "road" / "mine.txt").write_text("mine")
    assert main(["data", "road", "--out", str(tmp_path)]) == FAILED
    assert "nothing is overwritten" in capsys.readouterr().err
    capsys.readouterr()
    assert main(["data", "rood", "--out", str(tmp_path)]) == FAILED
    said = capsys.readouterr()
    assert "expected one of road" in said.err and said.out == ""


def test_the_list_says_where_real_data_comes_from(capsys):
    assert main(["data"]) == OK
    said = capsys.readouterr().out
    assert all(name in said for name in named_drives.NAMED_DRIVES)
    assert "https://pandaset.org (CC BY 4.0)" in said

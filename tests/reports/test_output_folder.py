"""What a run writes stays in its folder, and the folder is its own until it ends."""

import dataclasses
import subprocess
import sys

import pytest

from semloc_jax.datasets import open_drive
from semloc_jax.errors import SemlocError
from semloc_jax.inputs import segmentation
from semloc_jax.reports.folder import make_folder
from semloc_jax.storage import release_claims

CLAIM = """import sys
from pathlib import Path
from semloc_jax.reports.folder import make_folder
make_folder(Path(sys.argv[1]))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no locks on folders")
def test_a_second_run_on_one_folder_is_told_to_wait(tmp_path):
    out = make_folder(tmp_path / "out")
    try:
        second = subprocess.run([sys.executable, "-c", CLAIM, str(out)], capture_output=True, text=True, check=False)
        assert second.returncode == 1
        assert "another run is writing to it; wait for its end or give another --out" in second.stderr
    finally:
        release_claims()


def test_a_run_that_is_not_there_is_not_resumed(tmp_path):
    with pytest.raises(SemlocError, match="no such folder; give that of an unfinished run"):
        make_folder(None, tmp_path / "nowhere")
    assert not (tmp_path / "nowhere").exists()


@pytest.mark.parametrize("name", ["/tmp/abs", "../../up", "a/../../b"])
def test_masks_stay_in_their_folder_whatever_frames_and_cameras_are_called(simulated_road, tmp_path, name):
    frame = dataclasses.replace(open_drive(simulated_road).frames[0], id=name)
    out = tmp_path / "out"
    out.mkdir()
    path = segmentation._mask_path(out, name, frame)
    assert path.resolve().is_relative_to(out.resolve())
    assert path.parent.parent == out and path.suffix == ".png"

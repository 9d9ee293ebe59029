"""A drive that is named through results/latest stays the one that was meant while the run moves that link."""

import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest

from semloc_jax.cli.main import OK, main
from semloc_jax.inputs.paths import pinned, pinned_options
from semloc_jax.reports import explain, frames, landscape, track
from semloc_jax.reports.folder import make_folder

DRIVE = "results/latest/drive"
VERBS = {
    "localize": (frames, "report_frames"),
    "track": (track, "report_track"),
    "explain": (explain, "report_explanation"),
    "landscape": (landscape, "report_landscape"),
    "landscape --basin": (landscape, "report_basin"),
}


@pytest.fixture
def after_a_demo(simulated_road, tmp_path, monkeypatch):
    """A folder like the one in which `semloc demo` ran once."""
    shutil.copytree(simulated_road, tmp_path / "results/demo/drive")
    (tmp_path / "results/latest").symlink_to("demo", target_is_directory=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("verb", VERBS)
def test_the_drive_is_read_after_the_link_has_moved(verb, after_a_demo, monkeypatch):
    """The report reads lazily: the last frame is opened when results/latest points to the new run."""
    module, name = VERBS[verb]
    read = {}

    def report(inputs, *args, **options):
        folder = make_folder(None)
        frame = inputs.drive.frames[-1]
        assert inputs.masks.masks(frame)
        read.update(shape=frame.image("front").shape, num_elements=len(inputs.map.elements))
        done = {"text": "", "folder": folder, "localized_share": 1.0, "tracking_share": 1.0, "is_lost": False}
        return SimpleNamespace(**done, explanations=(1,))

    monkeypatch.setattr(module, name, report)
    words = [*verb.split(), DRIVE, "--masks", "sem_net", "--map", f"{DRIVE}/map.geojson", "--prior", "gnss"]
    assert main(words) == OK
    assert Path("results/latest").resolve() != Path("results/demo").resolve()
    assert read["shape"] == (300, 480, 3) and read["num_elements"] > 10


def test_only_links_among_the_parents_are_followed(after_a_demo):
    place = Path("results/latest")
    assert pinned(place / "drive") == after_a_demo / "results/demo/drive"
    assert pinned(place) == after_a_demo / "results/demo"
    assert pinned(Path("results/demo/drive")) == Path("results/demo/drive")
    assert pinned(place / "absent.geojson") == place / "absent.geojson"
    Path("mine").symlink_to("results/demo/drive")
    assert pinned(Path("mine")) == Path("mine"), "a drive keeps the name that the user gave it"


def test_every_option_but_out_is_followed(after_a_demo):
    from semloc_jax.cli.track import Options

    path = "results/latest/drive/map.geojson"
    options = Options(Path(DRIVE), map=path, masks="sem_net", out=Path(DRIVE), resume=Path("results/latest"))
    found = pinned_options(options)
    assert found.drive == after_a_demo / "results/demo/drive"
    assert found.map == str(after_a_demo / "results/demo/drive/map.geojson")
    assert (found.masks, found.out) == ("sem_net", Path(DRIVE))
    assert found.resume == after_a_demo / "results/demo"

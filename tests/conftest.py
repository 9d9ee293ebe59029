"""Strict settings for every test: float64, checked shapes, no window, data by environment variable.

SEMLOC_TYPECHECK=0 switches the jaxtyping + beartype import hook off (faster collection while working on one test).
SEMLOC_LITTLE_EFFORT=0 compiles as for users, which takes two to three times as long (`tests/effort.py`).
"""

import gc
import os
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

os.environ.setdefault("MPLBACKEND", "Agg")

from semloc_jax.runtime.prepare import prepare_jax
from tests.effort import is_little, take_little_effort

take_little_effort()
# The flags and the cache of the command line: what it, the notebooks and the test processes compile is compiled once.
prepare_jax()

import jax  # noqa: E402 - reads its environment now
import scipy.linalg  # noqa: E402, F401 - brings matrices of its own, whose threads are set below
from threadpoolctl import threadpool_limits  # noqa: E402

# As `prepare_jax` sets it for users: here a plugin of pytest has imported NumPy before.
threadpool_limits(1, "blas")

jax.config.update("jax_enable_x64", True)

if os.environ.get("SEMLOC_TYPECHECK", "1") != "0":
    from tests.type_checks import check_types_of

    check_types_of("semloc_jax")

from semloc_jax.runtime.allocator import return_large_blocks  # noqa: E402 - after the hook
from semloc_jax.runtime.effort import effort_for  # noqa: E402

return_large_blocks()
# Tracing makes many small objects and little garbage. As often as by default, a collection that looks at all objects
# of a long test process takes a twentieth of the processor.
gc.set_threshold(100_000, 20, 20)


@pytest.fixture(scope="session", autouse=True)
def one_effort() -> Iterator[None]:
    """A program that runs of many and of few frames have in common is compiled once, with the effort for few."""
    with ExitStack() as stack:
        if is_little():
            stack.enter_context(effort_for(1))
        yield


_FIRST = (
    "fuzz",
    "cli",
    "mapping",
    "alignment",
    "contracts",
    "system",
    "fusion",
    "calibration",
    "test_notebooks.py",
)
"""Rooms of tests that run first: fuzz forks a process for each input, which copies the tables of what this one holds;
then those that take longest, in this order."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Long rooms first: a file that a test process starts last would keep the others waiting."""
    rooms = {item: item.path.relative_to(Path(__file__).parent).parts[0] for item in items}
    items.sort(key=lambda item: _FIRST.index(rooms[item]) if rooms[item] in _FIRST else len(_FIRST))


_MOST_MAPPINGS = 20_000
"""Linux gives a process 65,530 memory mappings (vm.max_map_count), and each compiled program takes about 20 of them.
A test process that goes beyond crashes inside jaxlib: measured at the end of a whole run, in 3,000 programs."""


@pytest.fixture(scope="module", autouse=True)
def few_programs() -> Iterator[None]:
    """Programs that earlier modules compiled are let go before they are too many for one process."""
    yield
    if _num_mappings() > _MOST_MAPPINGS:
        jax.clear_caches()
        gc.collect()


def _num_mappings() -> int:
    try:
        return Path("/proc/self/maps").read_bytes().count(b"\n")
    except OSError:  # not Linux: no such limit
        return 0


def find_data() -> Path:
    """Folder with the shared drives and maps: SEMLOC_DATA, else shared/data beside the repository."""
    given = os.environ.get("SEMLOC_DATA")
    return Path(given) if given else Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of the shared drives and maps; the test is skipped where it is absent."""
    folder = find_data()
    if not folder.is_dir():
        pytest.skip(f"no shared data at {folder}; set SEMLOC_DATA to the folder that holds rendered_road")
    return folder


def _drive(data_dir: Path, name: str) -> Path:
    if not (data_dir / name).is_dir():
        pytest.skip(f"no drive {name} in {data_dir}")
    return data_dir / name


@pytest.fixture(scope="session")
def road_dir(data_dir: Path) -> Path:
    """The rendered road drive: one front camera, 150 frames."""
    return _drive(data_dir, "rendered_road")


@pytest.fixture(scope="session")
def garage_dir(data_dir: Path) -> Path:
    """The rendered garage drive: four fisheye cameras, 60 frames."""
    return _drive(data_dir, "rendered_garage")


@pytest.fixture(scope="module")
def single_precision() -> Iterator[None]:
    """float32, as everything runs for a user: with it go the programs that other tests and notebooks have compiled."""
    with jax.enable_x64(False):
        yield


@pytest.fixture(scope="session")
def simulated_road(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small simulated road drive: three frames of one front camera, exact and network-like masks, two maps."""
    from semloc_jax.simulation import SimulationConfig, simulate

    folder = tmp_path_factory.mktemp("simulated") / "road"
    simulate("road", 5, folder, SimulationConfig(num_frames=3, rate_hz=2.0, width_px=480, height_px=300))
    return folder

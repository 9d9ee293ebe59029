"""Build and load the kernels (room: native; host).

In: C++ sources, the system's compiler. Out: custom calls registered with JAX, or the reason why there are none.
They come in parts, each a library that is built when it is first asked for: a drive of one camera model does not wait
for the others. A part is built once for each version of the sources and of jaxlib and each kind of processor, and kept
behind this user's seal: what is loaded are the bytes that were checked.
"""

import ctypes
import functools
import hashlib
import logging
import os
import platform
import shlex
import shutil
import subprocess
import tempfile
from pathlib import Path

from semloc_jax.host import NativeStatus
from semloc_jax.storage import private_folder, read_sealed, sweep_once, temporary_prefix, write_sealed
from semloc_jax.storage.sealed import home_folder

SOURCES = Path(__file__).parent / "src"
COMMON = "common"
"""What every frame needs."""
_CAMERA_CALLS = (
    *("normal_equations", "visible_weight", "robust_cost", "project", "view", "ramp_values"),
    *("piece_sums", "refine"),
)
_CALLS = {
    COMMON: ("damped_step", "sums_by_index", "pack"),
    "any_camera": ("lookup", "accumulate"),
    "landmark_calls": ("seen", "eliminated"),
}
"""The parts but for the camera models, by their source; each of those is camera.cc for a class of cameras.h."""
SWITCH = "SEMLOC_NATIVE"
"""Environment variable; 0 turns the kernels off."""
# The parts of -ffast-math that loops need to be vectorised. The flag itself would make every process that loads the
# library round subnormal numbers to zero, and would take NaN for a number.
_ARITHMETIC = "-fno-math-errno -fno-trapping-math -fno-signed-zeros -fassociative-math -freciprocal-math"
_EFFORT = "-O2 -ftree-loop-vectorize -fvect-cost-model=dynamic"
"""Loops are vectorised as with -O3, which compiles a quarter longer and runs no faster."""
_FLAGS = f"-std=c++17 {_EFFORT} -march=native -mprefer-vector-width=512 {_ARITHMETIC} -fPIC -shared -w".split()
_TIMEOUT_S = 120
_log = logging.getLogger(__name__)


_loaded_parts: list[str] = []


def is_available() -> bool:
    """Whether the common kernels are built, loaded and registered; the first call builds them if need be."""
    return status().available


def status(part: str = COMMON) -> NativeStatus:
    """Builds, loads and registers a part of the kernels on the first call; never raises.

    Args:
        part: "common", "any_camera", "landmark_calls" or a class of native/src/cameras.h.
    """
    return _loaded(part)[0]


def loaded_parts() -> tuple[str, ...]:
    """The parts that this process has loaded."""
    return tuple(_loaded_parts)


def library(part: str = COMMON) -> ctypes.CDLL | None:
    """The kernels of a part that are called without XLA; None where there are none."""
    return _loaded(part)[1]


@functools.cache
def _loaded(part: str) -> tuple[NativeStatus, ctypes.CDLL | None]:
    if os.environ.get(SWITCH, "1") == "0":
        return NativeStatus(False, f"off: {SWITCH}=0"), None
    try:
        content, text = _library_content(part)
        loaded = _loaded_library(content)
        _register(loaded, part)
    except _NotBuilt as reason:
        if os.environ.get("CXX"):  # whoever names a compiler wants the kernels
            _log.warning("kernels: %s; pure JAX is used", reason)
        return NativeStatus(False, str(reason)), None
    except OSError as error:
        return NativeStatus(False, f"not loaded: {error}"), None
    _loaded_parts.append(part)
    return NativeStatus(True, text), loaded


class _NotBuilt(Exception):
    pass


def _library_content(part: str) -> tuple[bytes, str]:
    """The library and where it comes from."""
    path = _cache_folder() / f"kernels-{part}-{_fingerprint()}.bin"
    content = read_sealed(path)
    if content is not None:
        return content, f"loaded from {path}"
    command = compiler()
    if command is None:
        raise _NotBuilt("not built: no C++ compiler found (Debian: apt-get install g++); pure JAX is used")
    content = _compiled(command, part)
    if not write_sealed(path, content):
        _log.debug("kernels: not kept in %s; the next process builds them anew", path.parent)
    return content, f"built with {' '.join(command)}"


def compiler() -> list[str] | None:
    """Words of the command of the C++ compiler: CXX, which may have several (`ccache g++`), else what is found."""
    words = shlex.split(os.environ.get("CXX", ""))
    found = shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")
    return words or ([found] if found else None)


def _compiled(command: list[str], part: str) -> bytes:
    import jax.ffi

    with tempfile.TemporaryDirectory(prefix="semloc-kernels-") as folder:
        made = Path(folder) / "kernels.so"
        what = (
            [str(SOURCES / f"{part}.cc")] if part in _CALLS else [f"-DSEMLOC_CAMERA={part}", str(SOURCES / "camera.cc")]
        )
        words = [*command, *_FLAGS, f"-I{jax.ffi.include_dir()}", *what, "-o", str(made)]
        try:
            done = subprocess.run(words, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False)
            if done.returncode != 0:
                first = next((line for line in done.stderr.splitlines() if "error" in line), "no message")
                raise _NotBuilt(f"not built: {' '.join(command)} failed ({first.strip()})")
            return made.read_bytes()
        except (OSError, subprocess.TimeoutExpired) as error:
            raise _NotBuilt(f"not built: {' '.join(command)}: {error}") from error


def _loaded_library(content: bytes) -> ctypes.CDLL:
    """The library, loaded from a file of its own that no other process knows; the file goes once it is loaded."""
    home = _cache_folder()  # /tmp may forbid programs
    place = home if private_folder(home) else None
    prefix = temporary_prefix("kernels")
    if place is not None:
        sweep_once(place)
    with tempfile.TemporaryDirectory(prefix=prefix, dir=place, ignore_cleanup_errors=True) as folder:
        path = Path(folder) / "kernels.so"
        path.write_bytes(content)
        return ctypes.CDLL(str(path))


def _register(library: ctypes.CDLL, part: str) -> None:
    """Tell XLA the kernels of a part; those of a camera model are named after it, too."""
    import jax

    ending = "" if part in _CALLS else f"_{part}"
    for call in _CALLS.get(part, _CAMERA_CALLS):
        kernel = jax.ffi.pycapsule(getattr(library, f"semloc_{call}"))
        jax.ffi.register_ffi_target(f"semloc_{call}{ending}", kernel, platform="cpu")


def _cache_folder() -> Path:
    return home_folder() / "native"


def _fingerprint() -> str:
    import jaxlib

    parts = [jaxlib.__version__, " ".join(_FLAGS), platform.machine(), processor()]
    parts += [source.read_text() for source in sorted(SOURCES.iterdir())]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]


def processor() -> str:
    """Instruction sets: a home may be shared by machines of several kinds."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith(("flags", "Features"))), "")

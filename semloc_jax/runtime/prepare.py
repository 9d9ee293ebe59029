"""What has to be set before JAX is imported, and what JAX then runs on (room: runtime).

In: the environment and the processor. Out: XLA flags, a compilation cache, versions and device as text.
"""

import os
import platform
import sys
from pathlib import Path

from semloc_jax.storage.sealed import home_folder, others_can_write, private_folder

WIDTH_FLAG = "--xla_cpu_prefer_vector_width"
_BRIEF = "--xla_backend_extra_options=xla_cpu_disable_loop_unrolling,xla_cpu_disable_slp_vectorizer"
"""Compiles in three quarters of the time; what is compiled runs as fast: its inner loops are native kernels. Measured,
jaxlib 0.10.1."""
LEAST_COMPILE_S = 0.2
"""Programs that compile faster than this are not worth a file."""
_FATAL_ONLY = 3
"""Loading a cached program logs, as an error of some thousand letters, that pseudo features (prefer-no-gather) are
missing on the very machine that compiled it. Each kind of processor has its own folder: none is truly missing."""
_BLAS_THREADS = {name: "1" for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
"""NumPy's threads, where they are not set. Our matrices are small: two threads wait for each other longer than they
calculate, and a window of an inertial drive takes twice the processor time."""
_LINES_OF_CODE = 0
"""So many callers each operation of a program remembers (JAX: 10), for profilers; they take 4 % of a cold start."""
LIBRARIES = (
    "semloc-jax",
    "jax",
    "jaxlib",
    "equinox",
    "optimistix",
    "lineax",
    "jaxlie",
    "numpy",
    "scipy",
    "opencv-python-headless",
    "shapely",
)


def prepare_jax() -> None:
    """Set JAX up: wide vectors where the processor has them, and a compilation cache in the user's cache folder.

    NumPy gets one thread for its matrices, unless it is imported already. The command line calls this first, and so
    does the first use of a public name. Whatever the user has set stays as it is, but for a cache that other users can
    write to: what JAX loads from it runs. SEMLOC_CACHE=0 in the environment leaves the cache off. Where JAX is imported
    already, only the cache can still be set.
    """
    if "numpy" not in sys.modules:
        os.environ |= {name: number for name, number in _BLAS_THREADS.items() if name not in os.environ}
    if "jax" in sys.modules:
        _set_cache_of_loaded_jax()
        return
    os.environ["XLA_FLAGS"] = _with_flags(os.environ.get("XLA_FLAGS", ""))
    given = os.environ.get("JAX_COMPILATION_CACHE_DIR")
    if given and others_can_write(Path(given)):
        print(
            f"JAX_COMPILATION_CACHE_DIR {given}: other users can write to it, and compiled programs are code; "
            f"{cache_folder()} is used instead (chmod go-w makes the folder yours alone)",
            file=sys.stderr,
        )
        del os.environ["JAX_COMPILATION_CACHE_DIR"]
    if (folder := _own_cache()) is not None:
        os.environ["JAX_COMPILATION_CACHE_DIR"] = str(folder)
        os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", str(LEAST_COMPILE_S))
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", str(_FATAL_ONLY))
    os.environ.setdefault("JAX_TRACEBACK_IN_LOCATIONS_LIMIT", str(_LINES_OF_CODE))


def _with_flags(given: str) -> str:
    """The flags of XLA with ours added; what the user has set stays."""
    ours = [_BRIEF] if _BRIEF.split("=", 1)[0] not in given else []
    if WIDTH_FLAG not in given and "avx512f" in cpu_features():
        ours.append(f"{WIDTH_FLAG}=512")
    return " ".join([given, *ours]).strip()


def _set_cache_of_loaded_jax() -> None:
    """The compilation cache of a JAX that was imported without one, which has read the environment already."""
    import jax

    if jax.config.jax_compilation_cache_dir or (folder := _own_cache()) is None:
        return
    from jax.experimental.compilation_cache import compilation_cache

    jax.config.update("jax_compilation_cache_dir", str(folder))
    if "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS" not in os.environ:
        jax.config.update("jax_persistent_cache_min_compile_time_secs", LEAST_COMPILE_S)
    compilation_cache.reset_cache()  # what was compiled before has settled that there is none
    if os.environ.get("TF_CPP_MIN_LOG_LEVEL", "1") == "1":  # what JAX itself sets, and has read already
        from jaxlib.utils import absl_set_min_log_level

        absl_set_min_log_level(_FATAL_ONLY)


def _own_cache() -> Path | None:
    """The cache folder of this package; None where the user has chosen, wants none, or the disk refuses."""
    if "JAX_COMPILATION_CACHE_DIR" in os.environ or os.environ.get("SEMLOC_CACHE") == "0":
        return None
    folder = cache_folder()
    return folder if private_folder(folder) and is_writable(folder) else None


def cpu_features() -> frozenset[str]:
    """Instruction sets of the processor, empty where the system does not tell."""
    try:
        text = Path("/proc/cpuinfo").read_text()
    except OSError:
        return frozenset()
    for line in text.splitlines():
        if line.startswith(("flags", "Features")):
            return frozenset(line.split(":", 1)[1].split())
    return frozenset()


def cache_folder() -> Path:
    """Folder of compiled programs: one for each kind of processor, since a home may be shared by several."""
    import hashlib

    kind = f"{platform.machine()} {' '.join(sorted(cpu_features()))}"
    return home_folder() / f"jax-{hashlib.sha256(kind.encode()).hexdigest()[:12]}"


def is_writable(folder: Path) -> bool:
    """Whether files can be written to the folder, which is made if need be."""
    import tempfile

    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def versions() -> dict[str, str]:
    """Versions of Python, of this package and of the libraries that numbers depend on."""
    import importlib.metadata

    found = {"python": platform.python_version()}
    for name in LIBRARIES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "missing"
    return found


def device() -> str:
    """What JAX computes on, e.g. `cpu (2 cores)` or `gpu NVIDIA H200`."""
    import jax

    first = jax.devices()[0]
    return f"cpu ({os.cpu_count()} cores)" if first.platform == "cpu" else f"{first.platform} {first.device_kind}"

"""What a benchmark ran on, and what a process of it uses (room: bench; host).

In: this process and machine. Out: names, versions, pinned core, resident memory.
"""

import contextlib
import importlib.metadata
import os
import platform
import resource
import subprocess
from pathlib import Path

LIBRARIES = ("semloc-jax", "jax", "jaxlib", "optimistix", "lineax", "numpy", "scipy", "jaxopt", "torch", "gtsam")
ONE_THREAD = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
MIB = 1 / 1024


def versions() -> dict[str, str]:
    """Versions of Python, compiler and every library that is installed here."""
    found = {"python": platform.python_version()}
    for name in LIBRARIES:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            found[name] = importlib.metadata.version(name)
    with contextlib.suppress(OSError):
        said = subprocess.run(["g++", "-dumpfullversion"], capture_output=True, text=True, check=False).stdout.strip()
        found |= {"g++": said} if said else {}
    header = Path("/usr/include/ceres/version.h")
    if header.is_file():
        words = [line.split() for line in header.read_text().splitlines() if line.startswith("#define CERES_VERSION_")]
        found["ceres"] = ".".join(word[2] for word in words if len(word) == 3 and word[2].isdigit())
    return found


def machine() -> dict[str, object]:
    """Processor, cores, vector width, memory, system and load of this machine."""
    processor, features = platform.processor() or platform.machine(), ""
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            key, _, value = line.partition(":")
            processor = value.strip() if key.strip() == "model name" else processor
            features = value if key.strip() == "flags" else features
    vectors = next((name for name in ("avx512f", "avx2", "avx") if name in features.split()), "none")
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30 if hasattr(os, "sysconf") else 0.0
    return {
        "processor": processor,
        "cores": os.cpu_count(),
        "vectors": vectors,
        "memory_gib": round(memory, 1),
        "system": f"{platform.system()} {platform.release()}",
        "load": round(os.getloadavg()[0], 2),
    }


def cores() -> list[int]:
    """Cores that this process may run on; empty where the system does not pin."""
    return sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []


def pin(core: int | None, pid: int | None = None) -> None:
    """Keep a process (None: this one), all its threads and what it starts later on one core."""
    if core is None or not hasattr(os, "sched_setaffinity"):
        return
    for thread in Path(f"/proc/{pid or os.getpid()}/task").iterdir():
        with contextlib.suppress(ProcessLookupError):
            os.sched_setaffinity(int(thread.name), {core})


def forget_peak(pid: int | str = "self") -> None:
    """Start to measure the peak of resident memory anew, where the system can."""
    with contextlib.suppress(OSError):
        Path(f"/proc/{pid}/clear_refs").write_text("5")


def memory_mib(pid: int | str = "self") -> tuple[float, float]:
    """Resident memory now and its peak [MiB]."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * MIB
        return peak, peak
    kib = {line.split(":")[0]: float(line.split()[1]) for line in lines if line.startswith(("VmRSS", "VmHWM"))}
    return kib["VmRSS"] * MIB, kib["VmHWM"] * MIB

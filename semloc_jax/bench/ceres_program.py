"""Ceres Solver in C++, built from the sources under tests/ceres where g++ and libceres-dev are there (room: bench).

In: a Problem. Out: poses, and the CPU time that the program has measured of itself.
"""

import hashlib
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from semloc_jax.bench.peer import PeerMissing, Solved
from semloc_jax.bench.problem import Problem, to_binary
from semloc_jax.storage import private_folder, sweep_once, temporary_prefix
from semloc_jax.storage.sealed import home_folder

SOURCE = Path(__file__).resolve().parents[2] / "tests" / "ceres"
FLAGS = ("-std=c++17", "-O3", "-march=native", "-DNDEBUG", "-I/usr/include/eigen3")
LIBRARIES = ("-lceres", "-lglog")


def create(form: str) -> "CeresPeer":
    """`autodiff`, `block` or `tiny`."""
    return CeresPeer(build(), form)


def build() -> Path:
    """The program, built once for each state of its sources.

    Raises:
        PeerMissing: Sources, compiler or library are not here.
    """
    sources = sorted([*SOURCE.glob("*.cpp"), *SOURCE.glob("*.h")])
    compiler = shutil.which("g++")
    if not sources:
        raise PeerMissing(f"no sources in {SOURCE}; run from a checkout")
    if compiler is None:
        raise PeerMissing("no g++; install g++ and libceres-dev")
    version = subprocess.run([compiler, "--version"], capture_output=True, text=True, check=False).stdout
    state = hashlib.sha256(b"".join(path.read_bytes() for path in sources) + " ".join(FLAGS).encode())
    state.update(version.encode() + _processor().encode())
    program = home_folder() / f"ceres-{state.hexdigest()[:12]}" / "ceres_bench"
    if not private_folder(program.parent):
        raise PeerMissing(f"{program.parent} cannot be made a folder of this user alone; remove it")
    if program.is_file():
        return program
    sweep_once(program.parent)
    with tempfile.TemporaryDirectory(prefix=temporary_prefix(program.name), dir=program.parent) as folder:
        made = Path(folder) / program.name
        command = [compiler, *FLAGS, str(SOURCE / "bench.cpp"), "-o", str(made), *LIBRARIES]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            said = next((line for line in done.stderr.splitlines() if "error" in line), "the compiler failed")
            raise PeerMissing(f"{said}; install libceres-dev")
        made.replace(program)
    return program


def _processor() -> str:
    """What -march=native means here: a home may be shared by several machines."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return ""
    return next((line for line in lines if line.startswith(("flags", "Features"))), "")


class CeresPeer:
    """A running program that gets starts through a pipe."""

    def __init__(self, program: Path, form: str) -> None:
        self.program, self.form, self.process = program, form, None

    def load(self, problem: Problem) -> None:
        """Start the program with the problem as a file."""
        self.close()
        with tempfile.NamedTemporaryFile(suffix=".bin") as file:
            file.write(to_binary(problem))
            file.flush()
            command = [str(self.program), file.name, self.form]
            self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
            self.solve(problem.T_true[None], (0,))  # the file is read when this has been answered

    def solve(self, Ts_init: np.ndarray, levels: tuple[int, ...]) -> Solved:
        """All starts, one after another."""
        words = [len(Ts_init), len(levels), *levels]
        self.process.stdin.write(" ".join(map(str, words)).encode() + b"\n")
        self.process.stdin.write(np.ascontiguousarray(Ts_init, "<f8").tobytes())
        self.process.stdin.flush()
        answer = self.process.stdout.readline().split()
        if len(answer) != 2:
            raise RuntimeError(f"{self.program} {self.form} ended with code {self.process.wait()}")
        Ts = np.frombuffer(self.process.stdout.read(Ts_init.size * 8), "<f8").reshape(-1, 4, 4)
        return Solved(Ts, float(answer[1]), float(answer[0]))

    def close(self) -> None:
        """End the program."""
        if self.process is not None:
            self.process.stdin.close()
            self.process.stdout.close()
            self.process.wait(10)
            self.process = None

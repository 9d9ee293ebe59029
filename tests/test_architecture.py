"""The house rules as a fast test on the syntax trees: who may import whom, names and length of files."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "semloc_jax"

RANK = {
    "door": 0,
    "errors": 0,
    "host": 0,
    "structs": 0,
    "geometry": 0,
    "storage": 0,
    "native": 1,
    "solvers": 1,
    "runtime": 2,
    "cameras": 2,
    "maps": 2,
    "evaluation": 2,
    "perception": 3,
    "residuals": 3,
    "datasets": 3,
    "simulation": 4,
    "alignment": 4,
    "inputs": 5,
    "fusion": 5,
    "localization": 6,
    "mapping": 6,
    "bench": 6,
    "calibration": 7,
    "learning": 7,
    "analysis": 7,
    "viz": 8,
    "web": 8,
    "reports": 9,
    "explorer": 9,
    "service": 9,
    "cli": 10,
}
# Ground that every room may stand on.
GROUND = {"door", "errors", "host", "geometry", "storage", "structs"}
# Rooms that may use less than their rank allows.
ONLY = {"evaluation": GROUND}
NEVER = {"datasets": {"perception", "solvers", "localization"}, "residuals": {"maps", "perception"}}

PURE_JAX = {"residuals", "solvers", "geometry", "structs"}
HOST_CAMERAS = {"io"}
HOST_LIBRARIES = {"cv2", "skimage", "scipy", "matplotlib", "time", "os", "io", "pathlib", "shutil", "tempfile"}
HOST_LIBRARIES |= {"pickle", "subprocess", "ctypes", "yaml", "socket", "urllib"}
# Sparse factorisation has no counterpart in JAX.
HOST_EXCEPTIONS = {("semloc_jax.solvers.sparse", "scipy")}
PURE_LABEL = re.compile(r"\(room:[^)]*pure\s+JAX")
LABELLED = {"alignment"}
"""Rooms whose modules are pure where the first lines of their docstring say so."""
DOOR = "semloc_jax"
"""The front page tells pure rooms, which know no host, where kernels and stored programs come from (`host.offer`)."""
HOMES = {
    "optimistix": {"solvers", "bench"},
    "lineax": {"solvers", "bench"},
    "jaxlie": {"geometry"},
    "matplotlib": {"viz"},
    "tyro": {"cli"},
    "ray": {"runtime"},
    "yaml": {"cli", "inputs", "reports", "perception", "datasets", "semloc_jax.cameras.io", "semloc_jax.maps.io"},
    # Peers of the benchmark: optional, imported when they are measured.
    "jaxopt": {"bench"},
    "gtsam": {"bench"},
    "torch": {"bench"},
    "evo": set(),  # GPL: an outside oracle of the tests only
    "lanelet2": set(),
}
BANNED_NAMES = {"util", "utils", "helper", "helpers", "common", "misc", "manager", "managers"}
MAX_LINES = 400


@dataclass(frozen=True)
class Import:
    """One imported module, as a full dotted name, with where it stands."""

    module: str
    target: str
    line: int
    for_types_only: bool
    at_import: bool


def _module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _is_type_checking(test: ast.expr) -> bool:
    return (isinstance(test, ast.Name) and test.id == "TYPE_CHECKING") or (
        isinstance(test, ast.Attribute) and test.attr == "TYPE_CHECKING"
    )


def _targets(node: ast.Import | ast.ImportFrom, module: str, is_package: bool) -> Iterator[str]:
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
        return
    base = module.split(".")
    if node.level:
        base = base[: len(base) - node.level + (1 if is_package else 0)]
        base += node.module.split(".") if node.module else []
    else:
        base = (node.module or "").split(".")
    # `from semloc_jax.maps import sampling` imports the module `semloc_jax.maps.sampling`.
    for alias in node.names:
        full = [*base, alias.name]
        path = ROOT.joinpath(*full)
        yield ".".join(full if path.is_dir() or path.with_suffix(".py").is_file() else base)


def _walk(node: ast.AST, for_types_only: bool, at_import: bool) -> Iterator[tuple[ast.AST, bool, bool]]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If) and _is_type_checking(child.test):
            for statement in child.body:
                yield statement, True, at_import
                yield from _walk(statement, True, at_import)
            for statement in child.orelse:
                yield statement, for_types_only, at_import
                yield from _walk(statement, for_types_only, at_import)
            continue
        inside = at_import and not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
        yield child, for_types_only, inside
        yield from _walk(child, for_types_only, inside)


def imports_of(source: str, module: str, is_package: bool = False) -> list[Import]:
    """Every import of a module, lazy ones inside functions included."""
    found = []
    for node, types_only, at_import in _walk(ast.parse(source), False, True):
        if isinstance(node, ast.Import | ast.ImportFrom):
            for target in _targets(node, module, is_package):
                found.append(Import(module, target, node.lineno, types_only, at_import))
    return found


def _room(module: str) -> str:
    parts = module.split(".")
    return parts[1] if len(parts) > 1 else ""


def _is_pure_jax(module: str) -> bool:
    parts = module.split(".")
    return _room(module) in PURE_JAX or (parts[1:2] == ["cameras"] and not HOST_CAMERAS & set(parts))


def rank_faults(item: Import) -> list[str]:
    """What the import ranks have against one import; imports for type checkers are bound by them too."""
    if item.target.split(".")[0] != "semloc_jax":
        return []
    here, there = _room(item.module), _room(item.target)
    place = f"{item.module}:{item.line} imports {item.target}"
    if not here or here == there:
        return []
    if not there:
        return [] if here == "cli" else [f"{place}: the package's front page is for users, import the room itself"]
    if there not in RANK or here not in RANK:
        return [f"{place}: a room without a rank; add it to RANK with the reason"]
    faults = []
    if there == "cli":
        faults.append(f"{place}: nobody imports cli")
    if RANK[there] > RANK[here] or (RANK[there] == RANK[here] and there not in GROUND):
        faults.append(f"{place}: rank {RANK[here]} may import lower ranks only, {there} has {RANK[there]}")
    if there in NEVER.get(here, set()) or (here in ONLY and there not in ONLY[here]):
        faults.append(f"{place}: {here} must never know {there}")
    return faults


def library_faults(item: Import) -> list[str]:
    """What the house has against importing one outside library here; imports for type checkers cost nothing."""
    library = item.target.split(".")[0]
    if item.for_types_only or library == "semloc_jax":
        return []
    place = f"{item.module}:{item.line} imports {item.target}"
    faults = []
    if library in HOMES:
        homes = HOMES[library]
        if _room(item.module) not in homes and not any(item.module.startswith(h) for h in homes if "." in h):
            faults.append(f"{place}: {library} belongs in {sorted(homes) or 'the tests'} only")
    if _is_pure_jax(item.module) and library in HOST_LIBRARIES and (item.module, library) not in HOST_EXCEPTIONS:
        faults.append(f"{place}: a pure JAX module takes no host library")
    return faults


def _files() -> list[Path]:
    return sorted(PACKAGE.rglob("*.py"))


@cache
def _all_imports() -> list[Import]:
    sources = ((path.read_text(encoding="utf-8"), _module_name(path), path.name == "__init__.py") for path in _files())
    return [item for source in sources for item in imports_of(*source)]


def test_imports_follow_the_ranks():
    faults = [fault for item in _all_imports() for fault in rank_faults(item)]
    assert not faults, "\n".join(faults)


def test_libraries_stay_in_their_rooms():
    faults = [fault for item in _all_imports() for fault in library_faults(item)]
    assert not faults, "\n".join(faults)


def test_pure_jax_modules_open_no_files():
    faults = []
    for path in _files():
        if not _is_pure_jax(_module_name(path)):
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "open":
                faults.append(f"{_module_name(path)}:{node.lineno} opens a file")
    assert not faults, "\n".join(faults)


def _reached(items: list[Import], modules: set[str]) -> tuple[dict[str, set[str]], dict[str, set[str]]]:
    """Modules and outside libraries that each module imports itself; it runs the pages of its packages as well."""
    ours: dict[str, set[str]] = {module: set() for module in modules}
    libraries: dict[str, set[str]] = {module: set() for module in modules}
    for item in items:
        if item.for_types_only or item.module not in modules:
            continue
        library = item.target.split(".")[0]
        if library != "semloc_jax":
            libraries[item.module] |= {library} - {name for module, name in HOST_EXCEPTIONS if module == item.module}
            continue
        parts = item.target.split(".")
        ours[item.module] |= {".".join(parts[:k]) for k in range(2, len(parts) + 1)} & modules
    for module in modules:
        parts = module.split(".")
        ours[module] |= {".".join(parts[:k]) for k in range(2, len(parts))} & modules
        ours[module] -= {module, DOOR}
    return ours, libraries


def host_faults(items: list[Import], modules: set[str], pure: set[str]) -> list[str]:
    """Ways from a pure JAX module to files, processes or pictures, over any number of imports, lazy ones included."""
    ours, libraries = _reached(items, modules)
    faults = []
    for module in sorted(pure):
        came_from: dict[str, str | None] = {module: None}
        waiting = [module]
        while waiting:
            here = waiting.pop(0)
            if libraries[here] & HOST_LIBRARIES:
                trail = [here]
                while (before := came_from[trail[-1]]) is not None:
                    trail.append(before)
                faults.append(
                    f"{' -> '.join(reversed(trail))} -> {', '.join(sorted(libraries[here] & HOST_LIBRARIES))}"
                )
                break
            for target in sorted(ours[here] - set(came_from)):
                came_from[target] = here
                waiting.append(target)
    return faults


def _pure_modules() -> set[str]:
    found = set()
    for path in _files():
        text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
        module = _module_name(path)
        if _is_pure_jax(module) or (_room(module) in LABELLED and PURE_LABEL.search(text)):
            found.add(module)
    return found


def test_pure_jax_reaches_no_host_through_anything():
    faults = host_faults(_all_imports(), {_module_name(path) for path in _files()}, _pure_modules())
    assert not faults, "\n".join(faults)


def test_one_frame_is_pure_jax_but_for_its_doors():
    """The label of a docstring is what the rule goes by: these must carry it."""
    names = ("pose", "problem", "hypotheses", "implicit", "proposals", "level_choice", "same_pose", "along_road")
    assert {f"semloc_jax.alignment.{name}" for name in names} <= _pure_modules()


def test_a_way_to_the_host_is_found_over_other_modules():
    modules = {"semloc_jax.residuals.a", "semloc_jax.maps", "semloc_jax.maps.b", "semloc_jax.maps.c"}
    items = [
        *imports_of("import semloc_jax.maps.b", "semloc_jax.residuals.a"),
        *imports_of("def f():\n    import semloc_jax.maps.c", "semloc_jax.maps.b"),
        *imports_of("import pickle", "semloc_jax.maps.c"),
    ]
    (fault,) = host_faults(items, modules, {"semloc_jax.residuals.a"})
    assert fault == "semloc_jax.residuals.a -> semloc_jax.maps.b -> semloc_jax.maps.c -> pickle"
    page = imports_of("import tempfile", "semloc_jax.maps", is_package=True)
    (fault,) = host_faults([items[0], *page], modules, {"semloc_jax.residuals.a"})
    assert fault == "semloc_jax.residuals.a -> semloc_jax.maps -> tempfile"
    typed = imports_of("if TYPE_CHECKING:\n    import pickle", "semloc_jax.residuals.a")
    assert host_faults(typed, modules, {"semloc_jax.residuals.a"}) == []


def test_the_rules_name_only_what_exists():
    rooms = {path.stem for path in PACKAGE.iterdir() if path.suffix == ".py" or (path / "__init__.py").is_file()}
    named = {*RANK, *GROUND, *ONLY, *NEVER, *PURE_JAX, *(name for names in NEVER.values() for name in names)}
    named |= {home for homes in HOMES.values() for home in homes if "." not in home}
    assert named <= rooms, f"rules for rooms that are not there: {sorted(named - rooms)}"
    dotted = {home for homes in HOMES.values() for home in homes if "." in home}
    dotted |= {f"semloc_jax.cameras.{name}" for name in HOST_CAMERAS}
    dotted |= {module for module, _ in HOST_EXCEPTIONS}
    modules = {_module_name(path) for path in _files()}
    assert dotted <= modules, f"rules for modules that are not there: {sorted(dotted - modules)}"


def test_every_room_has_a_rank():
    rooms = {p.stem for p in PACKAGE.iterdir() if p.suffix == ".py" or (p / "__init__.py").is_file()} - {"__init__"}
    assert rooms <= set(RANK) | {"__main__"}, f"rooms without a rank: {sorted(rooms - set(RANK))}"


def test_no_import_cycle():
    """No module reaches itself through imports that run when it is loaded."""
    modules = {_module_name(path) for path in _files()}
    edges: dict[str, set[str]] = {module: set() for module in modules}
    for item in _all_imports():
        if item.at_import and not item.for_types_only and item.target in modules and item.target != item.module:
            edges[item.module].add(item.target)
    state: dict[str, int] = {}
    trail: list[str] = []

    def visit(module: str) -> None:
        state[module] = 1
        trail.append(module)
        for target in sorted(edges[module]):
            # A package page that gathers names of its own modules, imported by them, would be a cycle as well.
            assert state.get(target) != 1, " -> ".join([*trail[trail.index(target) :], target])
            if target not in state:
                visit(target)
        trail.pop()
        state[module] = 2

    for module in sorted(modules):
        if module not in state:
            visit(module)


@pytest.mark.parametrize("folder", ["semloc_jax", "tests"])
def test_no_file_is_too_long_or_named_for_nothing(folder):
    faults = []
    for path in sorted((ROOT / folder).rglob("*.py")):
        num_lines = len(path.read_text(encoding="utf-8").splitlines())
        if num_lines > MAX_LINES:
            faults.append(f"{path.relative_to(ROOT)} has {num_lines} lines; split it at {MAX_LINES}")
        if set(re.split(r"[_.]", path.stem)) & BANNED_NAMES or path.parent.name in BANNED_NAMES:
            faults.append(f"{path.relative_to(ROOT)}: name the file for the noun it holds")
    assert not faults, "\n".join(faults)


def test_front_page_is_light():
    """`import semloc_jax` loads neither JAX nor OpenCV nor anything that draws or parses."""
    heavy = "jax", "numpy", "cv2", "matplotlib", "tyro", "scipy", "semloc_jax.viz", "semloc_jax.cli"
    code = f"import sys, semloc_jax; print(*[name for name in {heavy!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.split() == []


@pytest.mark.parametrize(
    ("module", "source", "words"),
    [
        ("semloc_jax.residuals.alignment", "from semloc_jax.maps import sampling", "must never know maps"),
        ("semloc_jax.maps.elements", "def f():\n    import semloc_jax.perception.masks", "lower ranks only"),
        ("semloc_jax.cameras.base", "from ..maps import elements", "lower ranks only"),
        ("semloc_jax.evaluation.metrics", "import semloc_jax.solvers", "must never know solvers"),
        ("semloc_jax.viz.bev", "if TYPE_CHECKING:\n    from semloc_jax.cli import main", "nobody imports cli"),
        ("semloc_jax.solvers.arrow", "import scipy.optimize", "pure JAX"),
        ("semloc_jax.alignment.frame_localizer", "import matplotlib.pyplot as plt", "belongs in ['viz']"),
        ("semloc_jax.evaluation.metrics", "import evo", "the tests only"),
    ],
)
def test_the_rules_bite(module, source, words):
    faults = [fault for item in imports_of(source, module) for fault in rank_faults(item) + library_faults(item)]
    assert any(words in fault for fault in faults), faults


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("semloc_jax.maps.elements", "import typing\nif typing.TYPE_CHECKING:\n    import matplotlib.figure"),
        ("semloc_jax.cameras.io", "import yaml"),
        ("semloc_jax.structs", "from semloc_jax.geometry import lie"),
    ],
)
def test_the_rules_let_pass(module, source):
    faults = [fault for item in imports_of(source, module) for fault in rank_faults(item) + library_faults(item)]
    assert faults == []

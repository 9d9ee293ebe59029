"""The examples in the docstrings of the public door: every function has one, and each says what is true."""

import doctest
import inspect
import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import semloc_jax as sj

pytestmark = pytest.mark.usefixtures("single_precision")
FUNCTIONS = [
    name for name in sj.__all__ if inspect.isfunction(getattr(sj, name)) or hasattr(getattr(sj, name), "jitted")
]


@pytest.fixture(scope="module")
def names(simulated_road, tmp_path_factory):
    """What the examples start from; what one of them makes is there for the next, in the order of the data flow."""
    found = {"sj": sj, "np": np, "jnp": jnp, "jax": jax, "folder": simulated_road}
    found |= {"tmp": tmp_path_factory.mktemp("examples"), "drive": sj.open_drive(simulated_road)}
    found["semantic_map"] = sj.read_map(found["drive"].map_path)
    lines = [("lane_marking", [[0, 2, 0], [30, 2, 0]]), ("lane_marking", [[0, -2, 0], [30, -2, 0]])]
    found["street"] = sj.map_from_arrays([*lines, ("stop_line", [[14, -1.9, 0], [14, 1.9, 0]])])
    camera = sj.camera_from_K([[400, 0, 319.5], [0, 400, 199.5], [0, 0, 1]], (640, 400))
    found["rig"] = sj.Rig([camera], [sj.mounted((1.6, 0.0, 1.4), down_deg=4.0)], ["front"])
    found["mask"] = sj.render_masks(found["street"], found["rig"], sj.planar_pose(2.0, 0.1, 0.01))[0]
    found["classes"] = {10: "lane_marking", 12: "stop_line"}
    return found


@pytest.fixture(scope="module")
def done():
    """Functions whose examples have run."""
    return set()


def _run(name, thing, names):
    text = inspect.getdoc(thing)
    example = doctest.DocTestParser().get_doctest(text, names, name, None, None)
    example.globs = names  # one world for all: what an example makes may be used by those after it
    said = []
    doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(example, out=said.append, clear_globs=False)
    assert example.examples, f"{name} has no example"
    assert not said, "".join(said)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_every_public_function_has_an_example_that_is_true(name, names, done):
    """Those before it run first: another process may have had them."""
    for before in FUNCTIONS[: FUNCTIONS.index(name) + 1]:
        if before not in done:
            done.add(before)
            _run(before, getattr(sj, before), names)


def test_the_lines_from_arrays_in_the_readme_run_as_they_are(capsys):
    """A reader who types them has no file of ours; the pose is that of the mask, and the gradient a number."""
    text = (Path(__file__).resolve().parents[1] / "README.md").read_text()
    _, arrays, gradient = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    told = arrays + gradient.replace("jax.grad(forward_m)(400.0)", "slope = jax.grad(forward_m)(400.0)")
    seen = {}
    exec(told, seen)
    np.testing.assert_allclose(seen["found"].T_map_base[:2, 3], [2.0, 0.1], atol=0.05)
    assert "CONVERGED" in capsys.readouterr().out
    assert np.isfinite(seen["slope"]) and seen["slope"] != 0.0


def test_the_tour_of_the_package_is_true(names):
    _run("semloc_jax", sj, dict(names))


def test_the_tour_names_every_public_function():
    assert [name for name in FUNCTIONS if name not in sj.__doc__] == []


def test_public_names_come_from_few_rooms():
    assert len({module.split(".")[0] for module in sj._ROOMS}) <= 12

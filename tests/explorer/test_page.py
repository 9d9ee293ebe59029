"""The page in a real browser: the pose is dragged, everything follows at once, and the solver finds the way back."""

import os
from collections.abc import Iterator

import numpy as np
import pytest

from semloc_jax.explorer import ExplorerServer
from tests.explorer import browser

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        os.environ.get("SEMLOC_BROWSER") != "1",
        reason="updates a second depend on what else the machine does; on a quiet one set SEMLOC_BROWSER=1",
    ),
]
READY = "document.querySelector('#loading.done') && window.explorer.answer && !window.explorer.isBusy()"


@pytest.fixture(scope="module")
def page(explorer: ExplorerServer) -> Iterator[browser.Browser]:
    """The page, loaded and at rest."""
    found = browser.find()
    if found is None:
        pytest.skip("no chromedriver with chromium or chrome; apt-get install chromium chromium-driver")
    with browser.Browser(*found, 1440, 900) as opened:
        opened.open(explorer.url)
        opened.wait_for(READY)
        yield opened


def _ink(page):
    """A number for what is drawn over the image."""
    return page.run("document.querySelector('#cameras canvas').toDataURL().length")


def _off_truth(page):
    """Distance to the truth [m] and heading error [deg]."""
    pose, truth = page.run("[window.explorer.pose, window.explorer.scene.places.truth]")
    return np.hypot(pose["x_m"] - truth["x_m"], pose["y_m"] - truth["y_m"]), abs(pose["yaw_deg"] - truth["yaw_deg"])


def test_drag_and_solve(page):
    cost, ink = page.run("window.explorer.answer.head.cost"), _ink(page)
    assert cost < 0.2
    best = 0
    for turn in range(4):  # other work on the machine may spoil one
        car = page.run("window.explorer.carOnScreen()")
        forward = 1 if turn % 2 == 0 else -1
        steps = np.linspace(0, 1, 41)
        page.drag([(car["x"] + 14 * s, car["y"] - 22 * forward * s) for s in steps], 50)
        times = np.array(page.run("window.explorer.answered"))
        best = max(best, max(((times > t - 1000) & (times <= t)).sum() for t in times))
        if best >= 10 and turn % 2 == 0:
            break
    page.wait_for("!window.explorer.isBusy()")
    assert best >= 10, "updates a second"
    assert _off_truth(page)[0] > 0.7
    assert page.run("window.explorer.answer.head.cost") > cost + 0.2
    assert _ink(page) != ink
    page.click("#solve")
    page.wait_for("!document.getElementById('solve').disabled && !window.explorer.isBusy()")
    away_m, turned_deg = _off_truth(page)
    assert away_m < 0.05 and turned_deg < 0.2
    assert page.run("window.explorer.answer.head.cost") == pytest.approx(cost, abs=0.05)
    assert page.log() == []


def test_keys_levels_and_classes(page):
    page.press("t")
    page.wait_for("!window.explorer.isBusy()")
    assert _off_truth(page)[0] < 1e-9
    page.press("\ue013", times=3)  # arrow up: 10 cm forward each
    page.press("q", times=2)
    page.wait_for("!window.explorer.isBusy()")
    away_m, turned_deg = _off_truth(page)
    assert away_m == pytest.approx(0.3, abs=1e-6) and turned_deg == pytest.approx(0.5, abs=1e-6)
    page.click("#levels button:last-child")
    page.wait_for("!window.explorer.isBusy()")
    assert page.run("window.explorer.answer.head.level") == 3
    before = page.run("window.explorer.answer.head.coverage")
    page.click("#classes tr[data-channel=lane_marking] input")
    page.wait_for("!window.explorer.isBusy()")
    fits = page.run("window.explorer.answer.head.channels")
    assert next(fit for fit in fits if fit["name"] == "lane_marking")["in_view_px"] == 0
    assert page.run("window.explorer.answer.head.coverage") != before
    page.click("#frame-next")
    page.wait_for("window.explorer.scene.frame === 2 && window.explorer.answer && !window.explorer.isBusy()")
    assert page.log() == []

"""The Stanford diagram shows what the counts say."""

import numpy as np

from semloc_jax.viz.style import to_image
from semloc_jax.viz.tracking import IntegrityErrors, stanford_diagram


def diagram(error, level):
    return stanford_diagram({"lateral": IntegrityErrors(np.array(error), np.array(level), 0.29, "m")})


def test_titles_state_the_counts_of_each_direction():
    figure = stanford_diagram(
        {
            "lateral": IntegrityErrors(
                np.array([0.01, -0.02, 0.4, np.nan]), np.array([0.1, 0.5, 0.2, np.nan]), 0.29, "m"
            ),
            "heading": IntegrityErrors(np.zeros(3), np.full(3, 0.2), 0.5, "deg"),
        }
    )
    lateral, heading = figure.axes
    assert lateral.get_title() == "available 33.3%, misleading 0.0%, hazardous 1"
    assert heading.get_title() == "available 100.0%, misleading 0.0%, hazardous 0"
    assert lateral.get_ylabel() == "protection level [m]" and heading.get_xlabel() == "heading error [deg]"


def test_hazardous_points_are_red_and_available_ones_green():
    def pixels(picture, colour):
        return int(np.sum(np.all(np.abs(to_image(picture).astype(int) - colour) < 40, axis=-1)))

    red, green = (213, 0, 0), (46, 125, 50)
    many = np.full(40, 0.35) + np.linspace(0, 0.1, 40)
    bad, good = diagram(many, np.full(40, 0.2)), diagram(0.1 * many, np.full(40, 0.2))
    assert pixels(bad, red) > pixels(good, red) + 100 and pixels(good, green) > pixels(bad, green) + 30


def test_levels_beyond_the_picture_stay_on_its_edge():
    figure = diagram([0.01], [np.inf])
    (place,) = figure.axes[0].collections[-1].get_offsets()
    assert place[1] < figure.axes[0].get_ylim()[1]

"""The learned configuration that ships: localize takes it, and it is better on a drive that it was not learned from."""

import re
from pathlib import Path

import numpy as np
import pytest

import semloc_jax as sj
from semloc_jax.alignment.frame_localizer import LocalizeConfig
from semloc_jax.cli import localize
from semloc_jax.cli.arguments import read_settings
from semloc_jax.inputs.mask_source import mask_source
from semloc_jax.learning import LearningConfig, localizer_accuracy
from semloc_jax.simulation import SimulationConfig
from semloc_jax.structs import ElementClass

SHIPPED = Path(__file__).resolve().parents[2] / "configs" / "learned.yaml"


def learned():
    return read_settings(str(SHIPPED), localize.Options, LocalizeConfig())[0]


def test_the_shipped_file_says_where_it_comes_from_and_is_taken():
    head = SHIPPED.read_text().split("\n\n")[0]
    assert re.search("semloc learn .*--validation", head, re.DOTALL)
    settings = learned()
    weights = settings.frame.polish_view.class_weight
    assert weights == settings.frame.search_view.class_weight
    assert len(weights) == len(ElementClass)
    assert settings.noise.correlation_px != LocalizeConfig().noise.correlation_px
    assert settings.verdict == LocalizeConfig().verdict


@pytest.mark.slow
def test_it_is_more_accurate_and_more_honest_on_drives_that_were_held_out(tmp_path):
    """Three of the drives that its head names; mean error and NEES of all frames together."""
    errors, nees = [], []
    for seed, wear_share in ((301, 0.05), (302, 0.12), (304, 0.05)):
        size = SimulationConfig(12, 1.0, has_images=False, wear_share=wear_share)
        drive = sj.simulate("road", seed, tmp_path / str(seed), size)
        semantic_map, masks = sj.read_map(drive.map_path), mask_source("sem_net", drive)
        found = [
            localizer_accuracy(drive, semantic_map, masks, settings, LearningConfig(num_frames=12))
            for settings in (LocalizeConfig(), learned())
        ]
        assert [one.num_far for one in found] == [0, 0]
        errors.append([one.position_m for one in found])
        nees.append([one.nees for one in found])
    (error_before, error_after), (nees_before, nees_after) = np.mean(errors, axis=0), np.mean(nees, axis=0)
    assert error_after < error_before
    assert abs(np.log(nees_after)) < 0.7 * abs(np.log(nees_before))

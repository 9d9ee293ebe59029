"""Class tables: presets say what their data sets say, and a wrong table is noticed before it misleads a solver."""

import json

import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.perception import load_class_table, preset_names, read_mask
from semloc_jax.perception.class_table import parse_class_table
from semloc_jax.simulation.obstacles import OBSTACLE_IDS
from semloc_jax.structs import ElementClass

PAINT = (ElementClass.LANE_MARKING, ElementClass.STOP_LINE, ElementClass.CROSSWALK, ElementClass.ROAD_MARK)


def ids_of(table, label):
    index = table.channel_of(label)
    return () if index < 0 else table.channels[index].mask_ids


@pytest.mark.parametrize(
    ("name", "label", "ids"),
    [
        ("cityscapes", ElementClass.POLE, (5,)),
        ("cityscapes", ElementClass.SIGN, (7,)),
        ("cityscapes", ElementClass.LANE_MARKING, ()),
        ("mapillary", ElementClass.LANE_MARKING, (24,)),
        ("mapillary", ElementClass.CROSSWALK, (8, 23)),
        ("mapillary", ElementClass.POLE, (45, 47)),
        ("carla_0_9_14", ElementClass.LANE_MARKING, (24,)),
        ("carla_0_9_14", ElementClass.POLE, (6,)),
        ("carla_0_9_14", ElementClass.SIGN, (8,)),
        ("carla_0_9_13", ElementClass.LANE_MARKING, (6,)),
        ("carla_0_9_13", ElementClass.POLE, (5,)),
        ("carla_0_9_13", ElementClass.SIGN, (12,)),
        ("apolloscape", ElementClass.STOP_LINE, (216, 217, 215)),
        ("drive", ElementClass.LANE_MARKING, (10, 11)),
        ("lane_paint", ElementClass.ROAD_MARK, (1,)),
    ],
)
def test_presets_hold_the_published_ids(name, label, ids):
    assert set(ids_of(load_class_table(name), label)) == set(ids)


def test_one_mask_id_may_stand_for_several_map_classes():
    table = load_class_table("carla_0_9_14")
    assert {table.channel_of(label) for label in PAINT} == {0}
    assert table.channel_of(ElementClass.PILLAR) == -1
    assert table.channel_by_class[[ElementClass.LANE_MARKING, ElementClass.PILLAR]].tolist() == [0, -1]


def test_drive_preset_agrees_with_the_ids_of_the_drives(road_dir):
    classes = json.loads((road_dir / "meta.json").read_text())["classes"]
    table = load_class_table("drive")
    assert {name: number for number, name in table.id_names.items()} == classes | OBSTACLE_IDS
    masks = [read_mask(path) for path in sorted((road_dir / "sem" / "front").glob("*.png"))[::30]]
    assert table.report(masks).fits


def test_255_ego_and_dynamic_objects_are_unusable():
    assert load_class_table("drive").unusable_ids == (7, 8, 255)


def test_report_flags_a_table_that_does_not_fit():
    mask = np.full((40, 60), 1, np.uint8)
    mask[10:20] = 10
    mask[30:] = 22
    problems = load_class_table("cityscapes").report(mask).problems
    assert "22 (25.0 %" in problems[0]
    assert "none of the channels" in load_class_table("apolloscape").report(mask).problems[1]
    assert load_class_table("drive").report([mask]).share["lane_marking"] == pytest.approx(0.25)


def test_report_flags_a_channel_that_fills_the_image():
    mask = np.full((40, 60), 6, np.uint8)
    problems = load_class_table("carla_0_9_14").report(mask).problems
    assert len(problems) == 1 and "pole" in problems[0] and "100 %" in problems[0]


VALID = {
    "name": "mine",
    "ids": {"road": 0, "line": 1, "car": 2},
    "channels": [{"name": "paint", "masks": ["line"], "classes": ["lane_marking"]}],
    "dynamic": ["car"],
}


def test_own_table_from_a_file(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(json.dumps(VALID))
    table = load_class_table(path)
    assert table.name == "mine" and table.unusable_ids == (2, 255)
    assert table.channels[table.channel_index("paint")].mask_ids == (1,)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"chanels": []}, "unknown key 'chanels'; did you mean 'channels'"),
        ({"channels": [{"name": "p", "masks": ["lin"], "classes": ["pole"]}]}, "'lin'.*did you mean 'line'"),
        ({"channels": [{"name": "p", "masks": [1], "classes": ["lane_markin"]}]}, "did you mean 'lane_marking'"),
        ({"channels": [{"name": "p", "masks": [2], "classes": ["pole"]}]}, "also dynamic"),
        ({"channels": VALID["channels"] + [{"name": "q", "masks": [0], "classes": ["lane_marking"]}]}, "both|and 'q'"),
        ({"channels": []}, "has no channels"),
        ({"ids": {"road": 300}}, "0...255"),
        ({"dynamic": "car"}, "expected a list"),
    ],
)
def test_mistakes_in_a_table_are_named(change, message):
    with pytest.raises(SemlocError, match=message):
        parse_class_table({**VALID, **change})


def test_unknown_preset_gets_a_suggestion():
    with pytest.raises(SemlocError, match="did you mean 'cityscapes'"):
        load_class_table("cityscape")
    assert len(preset_names()) == 11


def test_unknown_channel_gets_a_suggestion():
    with pytest.raises(SemlocError, match="did you mean 'pole'"):
        load_class_table("drive").channel_index("poles")

"""One configuration serves every verb: what a file says reaches all of them, and what is misspelt is refused."""

import dataclasses
import importlib
from pathlib import Path

import pytest
import yaml

from semloc_jax.alignment.one_start import OneStartConfig
from semloc_jax.alignment.tracking_step import TrackAlignConfig
from semloc_jax.analysis.basin import BasinConfig
from semloc_jax.cli.arguments import parse, read_settings
from semloc_jax.cli.main import main
from semloc_jax.cli.shared_config import VERBS
from semloc_jax.errors import UsageError
from semloc_jax.inputs.config_files import SCENE, flags, flat_fields, own_fields, section_of, to_file, to_plain
from semloc_jax.residuals.noise import NoiseModel

CONFIGS = sorted((Path(__file__).resolve().parents[2] / "configs").glob("*.yaml"))
MODULES = {verb: importlib.import_module(f"semloc_jax.cli.{verb}") for verb in VERBS}
WORDS = {verb: ["drive"] for verb in VERBS} | {"survey": ["map.osm", "--camera", "calib.yaml"]}
MOST_VALUES = {"localize": 53, "track": 108}
"""Half of what each of them had when every solve was spelled out in the file."""


def settings_of(verb, path):
    return read_settings(str(path), MODULES[verb].Options, MODULES[verb].default_settings())


def scene_of(settings):
    return settings if section_of(settings) is None else getattr(settings, SCENE)


def leaves(content, prefix=()):
    for key, value in content.items():
        if isinstance(value, dict):
            yield from leaves(value, (*prefix, key))
        else:
            yield (*prefix, key), value


@pytest.fixture
def config(tmp_path):
    def write(content):
        path = tmp_path / "mine.yaml"
        path.write_text(content if isinstance(content, str) else yaml.safe_dump(content))
        return path

    return write


def test_the_four_places_and_what_was_learned_are_there():
    assert [path.stem for path in CONFIGS] == ["garage", "highway", "learned", "surround", "urban"]


@pytest.mark.parametrize("verb", VERBS)
@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_a_configuration_changes_just_what_it_says(path, verb):
    """Of the scene and of the section of the verb; what it says to other verbs is left aside."""
    defaults = MODULES[verb].default_settings()
    settings, words = settings_of(verb, path)
    said = dict(leaves(yaml.safe_load(path.read_text())))
    before, after = dict(leaves(to_file(defaults))), dict(leaves(to_file(settings)))
    assert words == []
    assert said
    changed = {key: value for key, value in after.items() if value != before[key]}
    assert changed == {key: value for key, value in said.items() if key in before and value != before[key]}


@pytest.mark.parametrize("verb", ["map", "odometry", "simulate", "learn_eyes"])
@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_verbs_with_a_configuration_of_their_own_leave_the_scene_aside(path, verb, config):
    module = importlib.import_module(f"semloc_jax.cli.{verb}")
    settings, words = read_settings(str(path), module.Options, module.default_settings())
    own = {field.name for field in dataclasses.fields(settings)}
    said = {key: value for key, value in yaml.safe_load(path.read_text()).items() if key in own}
    assert words == [] and to_file(settings) == {**to_file(module.default_settings()), **said}
    for wrong in ({"serach": {}}, {"verdict": {"max_csot": 1.0}}, {"track": {"helth": {}}}):
        with pytest.raises(UsageError, match="mine.yaml.*unknown key"):
            read_settings(str(config(wrong)), module.Options, module.default_settings())


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_a_file_that_changes_nothing_is_not_needed(path):
    assert any(settings_of(verb, path)[0] != MODULES[verb].default_settings() for verb in VERBS)


@pytest.mark.parametrize("verb", VERBS)
def test_one_word_of_noise_reaches_every_verb_and_every_solve_of_it(verb, config):
    path = config({"noise": {"noise_px": 1.25, "correlation_px": 33.0}})
    scene, noise = scene_of(settings_of(verb, path)[0]), NoiseModel(1.25, 33.0)
    frame, step = scene.frame, TrackAlignConfig()
    parts = (frame.search_view, frame.search_align, frame.polish_view, frame.polish_align)
    parts += scene.view_of(step.view), scene.align_of(step.align)
    assert [part.noise for part in parts] == [noise] * len(parts)


@pytest.mark.parametrize("verb", VERBS)
def test_the_backend_that_was_asked_for_is_that_of_every_solve(verb, config):
    scene = scene_of(settings_of(verb, config({"backend": "xla"}))[0])
    solves = scene.frame.search_align, scene.frame.polish_align, scene.align_of(TrackAlignConfig().align)
    assert [solve.path for solve in solves] == ["xla"] * 3


def test_surveys_and_basins_see_the_same_noise(config):
    path = config({"noise": {"noise_px": 1.25}})
    survey, localize = settings_of("survey", path)[0], settings_of("landscape", path)[0]
    start = BasinConfig(localize=localize).start
    parts = (survey.expected.view, survey.expected.align, start.view, start.align)
    assert [part.noise.noise_px for part in parts] == [1.25] * 4
    assert start.looks == OneStartConfig().looks


def test_what_is_learned_reaches_tracking_and_calibration():
    path = next(path for path in CONFIGS if path.stem == "learned")
    learned, *others = (scene_of(settings_of(verb, path)[0]) for verb in VERBS)
    for scene in others:
        assert (scene.road, scene.cost_maps, scene.noise, scene.view) == (
            learned.road, learned.cost_maps, learned.noise, learned.view,
        )  # fmt: skip
    assert learned.road.roll_pitch_deg == 0.372


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"noise": {"noise_xp": 1.0}}, "unknown key 'noise_xp'; did you mean 'noise_px'?"),
        ({"niose": {"noise_px": 1.0}}, "unknown key 'niose'; did you mean 'noise'?"),
        ({"track": {"confirm_frame": 3}}, "track: unknown key 'confirm_frame'; did you mean 'confirm_frames'?"),
        ({"track": {"health": {"max_cots": 1.0}}}, "track: health: unknown key 'max_cots'; did you mean 'max_cost'?"),
        ({"calibrate": {"priors": {"mount_degg": 1.0}}}, "did you mean 'mount_deg'?"),
        ({"calibrat": {"intrinsics": "all"}}, "unknown key 'calibrat'; did you mean 'calibrate'?"),
        ({"verdict": {"max_cots": 0.5}}, "verdict: unknown key 'max_cots'; did you mean 'max_cost'?"),
        ({"confirm_frames": 3}, "'confirm_frames' is no part of the scene; write it below 'track:'"),
        ({"track": 3}, "expected"),
    ],
)
@pytest.mark.parametrize("verb", VERBS)
def test_a_misspelt_key_is_refused_by_every_verb(verb, content, words, config):
    with pytest.raises(UsageError, match="mine.yaml") as refused:
        settings_of(verb, config(content))
    assert words in str(refused.value)


@pytest.mark.parametrize("verb", VERBS)
def test_what_a_verb_prints_it_reads_back_and_so_does_every_other(verb, config, capsys):
    assert main(["config", verb]) == 0
    path = config(capsys.readouterr().out)
    for other in VERBS:
        assert settings_of(other, path)[0] == MODULES[other].default_settings()


@pytest.mark.parametrize("verb", VERBS)
def test_options_of_one_verb_in_a_file_do_not_disturb_another(verb, config):
    """config.yaml of a run holds the options of its verb, too."""
    path = config({"frames": "::5", "overlays": 0, "fusion": "kalman", "masks": "sem", "shift_cm": 5.0})
    known = {field.name for field in dataclasses.fields(MODULES[verb].Options)}
    words = settings_of(verb, path)[1]
    assert ("--masks=sem" in words) == ("masks" in known)
    assert ("--fusion=kalman" in words) == (verb == "track")


@pytest.mark.parametrize("verb", VERBS)
def test_values_are_options_and_win_over_the_file(verb, config):
    path = config({"noise": {"noise_px": 1.5}, "view": {"max_range_m": 30.0}})
    options = parse(verb, MODULES[verb], [*WORDS[verb], "--config", str(path), "--noise.noise-px", "1.75"])
    scene = scene_of(options.settings)
    assert (scene.noise.noise_px, scene.view.max_range_m) == (1.75, 30.0)
    assert type(options.settings) is type(MODULES[verb].default_settings())


def test_values_of_a_verb_are_options_without_its_name(config):
    path = config({"track": {"confirm_frames": 3.0}, "calibrate": {"intrinsics": "focal"}})
    track = parse("track", MODULES["track"], ["drive", "--config", str(path), "--health.max-cost", "0.5"]).settings
    assert (track.confirm_frames, track.health.max_cost) == (3.0, 0.5)
    calibrate = parse("calibrate", MODULES["calibrate"], ["drive", "--config", str(path)]).settings
    assert calibrate.intrinsics == "focal"
    assert calibrate.scene == MODULES["calibrate"].default_settings().scene


@pytest.mark.parametrize("verb", VERBS)
def test_scene_and_verb_share_no_name(verb):
    settings = MODULES[verb].default_settings()
    if section_of(settings) is not None:
        assert not set(own_fields(settings)) & set(to_plain(scene_of(settings)))
        assert set(flat_fields(settings)) == set(own_fields(settings)) | set(to_plain(scene_of(settings)))


@pytest.mark.parametrize(("verb", "most"), MOST_VALUES.items())
def test_a_configuration_fits_on_a_page_or_two(verb, most):
    values = list(flags(MODULES[verb].default_settings()))
    assert len(values) <= most, "make what nobody changes a named constant with its reason"


@pytest.mark.parametrize("word", ["noise-px", "correlation-px", "ramp-share", "class-weight", "max-range-m", "loss"])
@pytest.mark.parametrize("verb", VERBS)
def test_what_a_scene_says_it_says_once(verb, word):
    said = [flag for flag in flags(MODULES[verb].default_settings()) if flag.endswith((f".{word}", f"-{word}"))]
    assert len(said) == 1, said

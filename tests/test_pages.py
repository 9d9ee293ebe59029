"""What the pages for readers say is true of the package: commands, options, the example of a calibration, links."""

import importlib
import re
from pathlib import Path

import numpy as np
import pytest

from semloc_jax.cameras.io import read_calibration
from semloc_jax.cameras.plausibility import implausible, view_angles_deg
from semloc_jax.cli.arguments import flat
from semloc_jax.cli.main import TEACHING, VERBS
from semloc_jax.inputs.config_files import flags

ROOT = Path(__file__).resolve().parents[1]
PAGES = ["README.md", "notebooks/FIGURES.md", "notebooks/OWN_DATA.md", ".github/CONTRIBUTING.md", "CHANGELOG.md"]
PAGES += sorted(str(path.relative_to(ROOT)) for path in (ROOT / "notebooks" / "figures").glob("*.md"))
COMMAND = re.compile(r"(?:^|`)semloc ([a-z-]+)([^`#|\n]*)", re.MULTILINE)


def text_of(page):
    return (ROOT / page).read_text(encoding="utf-8")


def known_options(verb):
    """Every option of a verb, those of its configuration included."""
    module = importlib.import_module(f"semloc_jax.cli.{verb.replace('-', '_')}")
    names = [f"--{name.replace('_', '-')}" for name in module.Options.__dataclass_fields__]
    if hasattr(module, "default_settings"):
        names += flags(flat(module.default_settings()))
    return {*names, "--help", "--debug"}


def test_the_readme_is_read_to_its_end():
    assert len(text_of("README.md").splitlines()) <= 200


def test_the_index_of_the_figures_names_all_pages():
    linked = set(re.findall(r"\]\((figures/\w+\.md)\)", text_of("notebooks/FIGURES.md")))
    assert linked == {page.removeprefix("notebooks/") for page in PAGES if "/figures/" in page}


@pytest.mark.parametrize("page", PAGES)
def test_every_command_on_a_page_exists(page):
    # A command may go on in the next line of a paragraph.
    commands = COMMAND.findall(re.sub(r"\n(?=--)", " ", text_of(page)))
    assert commands or page.startswith((".github", "CHANGELOG"))
    for verb, words in commands:
        if verb in ("verb", "--help"):
            continue
        assert verb in VERBS, f"{page}: semloc {verb}"
        if (verb, *words.split()[:1]) in TEACHING:
            verb = f"{verb}_{words.split()[0]}"
        options = re.findall(r"--[a-z][a-z0-9.-]*", words)
        unknown = set(options) - known_options(verb) if options else set()
        assert not unknown, f"{page}: semloc {verb} {unknown}"


@pytest.mark.parametrize("page", PAGES)
def test_every_link_into_the_repository_leads_somewhere(page):
    for target in re.findall(r"\]\(([^)#]+)\)", text_of(page)):
        if not target.startswith("http"):
            assert (ROOT / page).parent.joinpath(target).exists(), f"{page}: {target}"


def test_the_example_of_a_calibration_looks_ahead(tmp_path):
    (block,) = [b for b in re.findall(r"```yaml\n(.*?)```", text_of("notebooks/OWN_DATA.md"), re.DOTALL) if "cam0" in b]
    path = tmp_path / "calib.yaml"
    path.write_text(block)
    rig = read_calibration(path)
    assert rig.names == ("front",) and rig.cameras[0].resolution == (960, 600)
    assert not implausible(rig)
    np.testing.assert_allclose(view_angles_deg(np.asarray(rig.T_base_cam[0])), 0.0, atol=1e-9)
    np.testing.assert_allclose(rig.T_base_cam[0][:3, 3], [1.62, 0.0, 1.43])

"""Drives that the tables of figures name: anyone makes them from their seeds (room: simulation; host).

In: a name. Out: the drive on disk; where the real drives of the tables come from.
"""

from dataclasses import dataclass, field
from pathlib import Path

from semloc_jax.datasets.base import Drive
from semloc_jax.datasets.detect import open_drive
from semloc_jax.errors import SemlocError
from semloc_jax.simulation.degrade import Degradation
from semloc_jax.simulation.sensor_logs import SensorErrors
from semloc_jax.simulation.simulate import SimulationConfig, simulate
from semloc_jax.storage import write_text


@dataclass(frozen=True)
class NamedDrive:
    """A seeded drive with a name."""

    text: str
    kind: str
    seed: int
    config: SimulationConfig = field(default_factory=SimulationConfig)


@dataclass(frozen=True)
class RealDrive:
    """Recorded data that is not ours to give away."""

    text: str
    address: str
    licence: str


_BAD_MASKS = Degradation(wobble_px=1.6, wobble_length_px=10.0, erosion_share=0.5, missing_share=0.08, num_false=6.0)

NAMED_DRIVES = {
    "road": NamedDrive("a town road by day, one front camera", "road", 42, SimulationConfig(num_frames=100)),
    "garage": NamedDrive("a garage, four fisheyes", "garage", 43, SimulationConfig(num_frames=60)),
    "lights": NamedDrive(
        "a road at noon, with a low sun, at night",
        "road",
        44,
        SimulationConfig(num_frames=90, variants=("noon", "lowsun", "night")),
    ),
    "worn": NamedDrive(
        "a road with a third of its paint worn off", "road", 45, SimulationConfig(num_frames=60, wear_share=0.33)
    ),
    "poor_masks": NamedDrive(
        "a road with a poor network: wobbly borders, holes, inventions",
        "road",
        46,
        SimulationConfig(num_frames=60, degradation=_BAD_MASKS),
    ),
    "poor_fixes": NamedDrive(
        "a road with a poor receiver: 3.5 m of bias, a tenth of the fixes far off",
        "road",
        47,
        SimulationConfig(num_frames=60, sensors=SensorErrors(gnss_bias_m=3.5, gnss_outlier_share=0.1)),
    ),
    "small_images": NamedDrive(
        "a road seen by a camera of 400x250 pixels",
        "road",
        48,
        SimulationConfig(num_frames=60, width_px=400, height_px=250),
    ),
    "garage-ring": NamedDrive(
        "two laps of a garage with rings of aisles, four fisheyes, ends in a slot, masks only",
        "garage",
        50,
        SimulationConfig(laps=2, has_images=False),
    ),
    "lot": NamedDrive(
        "a parking lot with locks, signs and cones on some slots, four fisheyes, masks only",
        "lot",
        51,
        SimulationConfig(has_obstacles=True, has_images=False),
    ),
    "loop": NamedDrive(
        "two laps of a closed town road with look-alike intersections, masks only",
        "loop",
        49,
        SimulationConfig(laps=2, has_images=False, imu_rate_hz=200.0),
    ),
}
"""By the name of the folder that they are written to. A changed value here changes the figures that name it."""

REAL_DRIVES = {
    "KITTI raw": RealDrive(
        "a country road and a town street", "https://www.cvlibs.net/datasets/kitti/raw_data.php", "CC BY-NC-SA 3.0"
    ),
    "PandaSet 002": RealDrive("a busy street, six cameras", "https://pandaset.org", "CC BY 4.0"),
    "Argoverse 2": RealDrive("maps and drives of six cities", "https://www.argoverse.org/av2.html", "CC BY-NC-SA 4.0"),
    "Karlsruhe": RealDrive(
        "mapping_example.osm, a Lanelet2 map", "https://github.com/fzi-forschungszentrum-informatik/Lanelet2", "BSD-3"
    ),
    "esmini": RealDrive("OpenDRIVE maps e6mini, fabriksgatan", "https://github.com/esmini/esmini", "MPL-2.0"),
}
"""What the other rows of the tables rest on."""


def named_drive(name: str) -> NamedDrive:
    """What the drive of a name is.

    Raises:
        SemlocError: there is no drive of that name.
    """
    if name not in NAMED_DRIVES:
        raise SemlocError(f"no drive is called '{name}'; expected one of {', '.join(NAMED_DRIVES)}")
    return NAMED_DRIVES[name]


def make_named_drive(name: str, folder: Path) -> Drive:
    """The drive of a name, written into `folder/NAME` unless it is there already.

    Raises:
        SemlocError: there is no drive of that name, or another drive is in the folder.
    """
    named, place = named_drive(name), folder / name
    recipe, stated = f"{named!r}\n", place / "recipe.txt"
    if stated.is_file() and stated.read_text(encoding="utf-8") == recipe:
        return open_drive(place)
    if not stated.is_file() and place.is_dir() and any(place.iterdir()):
        raise SemlocError(f"{place}: holds something else; give another --out, nothing is overwritten")
    place.mkdir(parents=True, exist_ok=True)
    write_text(stated, "not finished\n")
    drive = simulate(named.kind, named.seed, place, named.config)
    write_text(stated, recipe)
    return drive

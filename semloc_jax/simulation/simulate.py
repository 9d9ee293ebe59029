"""A whole simulated drive on disk, in the drive layout (room: simulation; host).

In: kind, seed, folder. Out: Drive of the drive just written.
"""

import json
from dataclasses import dataclass, field, replace
from pathlib import Path

import jax
import numpy as np

from semloc_jax.cameras import Rig
from semloc_jax.cameras.io import write_calibration
from semloc_jax.datasets.base import Drive
from semloc_jax.datasets.detect import open_drive
from semloc_jax.datasets.drive import CLASS_IDS
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.trajectory import Trajectory, write_tum
from semloc_jax.maps import GeoOrigin, SemanticMap, write_drive_geojson
from semloc_jax.simulation.cameras import front_rig, surround_rig
from semloc_jax.simulation.country import build_country_road
from semloc_jax.simulation.degrade import Degradation
from semloc_jax.simulation.epochs import at_epoch
from semloc_jax.simulation.garage import build_garage
from semloc_jax.simulation.looks.look import AnyLook
from semloc_jax.simulation.map_errors import MapErrors, with_errors
from semloc_jax.simulation.motion import TrueMotion, VehicleMotion
from semloc_jax.simulation.obstacles import OBSTACLE_IDS
from semloc_jax.simulation.pictures import LOOKS, PictureSettings, write_pictures
from semloc_jax.simulation.road import build_road
from semloc_jax.simulation.scene import Scene, World
from semloc_jax.simulation.sensor_logs import SensorErrors, SensorPlan, write_sensor_logs
from semloc_jax.simulation.shade import Lighting
from semloc_jax.simulation.tours import Tour, TourWish, hall_tour, loop_tour, lot_tour
from semloc_jax.simulation.variation import Variation, variation
from semloc_jax.storage import claim, write_text

_ORIGIN = GeoOrigin(48.0712, 11.6523, 512.0)
LEAD_IN_S, _LEAD_OUT_S = 3.0, 1.0
"""Sensor logs run before the first and after the last frame."""
UNFINISHED = "unfinished.json"
"""Stands in the folder of a drive until all of it is there, and says what it follows from."""
_USUAL_FRAMES, _MOST_EPOCHS, _MOST_LAPS = 30, 1000, 50


@dataclass(frozen=True)
class SimulationConfig:
    """What a simulated drive is like.

    Args:
        num_frames: frames to render; None takes 30, and the whole way of drives with laps.
        rate_hz: frames per second; 0 takes 10 (road, country), 5 (loop, garage, lot), 4 (garage with laps).
        speed_mps: mean speed (loop: on the straight); 0 takes 11 (road), 14 (country), 9 (loop), 2.2 (garage), 3 (lot).
        width_px: image width; 0 takes 960 (road, country, loop) or 640 (garage, lot).
        height_px: image height; 0 takes 600 (road, country, loop) or 480 (garage, lot).
        variants: lightings, in equal parts of the drive; empty takes noon (road) or garage. `wild` gives every picture
            other surfaces, light, weather and lens.
        wear_share: share of the paint that is worn off (labelled as the ground below it).
        crown: share by which a road falls to both sides of its crown; 0 takes 0 (road) or 0.02 (country). A crowned
            road leans into its bends, too.
        has_studs: whether a row of short dashes (0.3 m, one each 1.2 m) runs beside the line to the left, on the far
            side of the crown (country).
        has_images: whether colour images are written too; masks alone take a fraction of the time.
        laps: how often to go round: 0 takes 2 in a loop, 1 in a lot, and in a garage the straight aisle without rings.
        has_obstacles: whether ground locks, no-parking signs and cones keep slots free (lot, garage with laps).
        epoch: state of the world: each epoch removes, moves, adds and repaints elements (changes.json).
        drive: number of a drive through the same world: other traffic, sensors, mounting and masks.
        imu_rate_hz: rows of imu.csv in a second.
        imu_offset_s: how far the clock of the IMU is ahead: it stamps time t with t + offset.
        gps_bias_m: horizontal length of the error that all fixes share; None draws it from sensors.gnss_bias_m.
        sensors: errors of the sensors.
        map_errors: faults of map_with_errors.geojson.
        degradation: how bad the network's masks are.
    """

    num_frames: int | None = None
    rate_hz: float = 0.0
    speed_mps: float = 0.0
    width_px: int = 0
    height_px: int = 0
    variants: tuple[str, ...] = ()
    wear_share: float = 0.05
    crown: float = 0.0
    has_studs: bool = False
    has_images: bool = True
    laps: int = 0
    has_obstacles: bool = False
    epoch: int = 0
    drive: int = 0
    imu_rate_hz: float = 100.0
    imu_offset_s: float = 0.0
    gps_bias_m: float | None = None
    sensors: SensorErrors = field(default_factory=SensorErrors)
    map_errors: MapErrors = field(default_factory=MapErrors)
    degradation: Degradation = field(default_factory=Degradation)


_DEFAULTS = {
    "road": {"rate_hz": 10.0, "speed_mps": 11.0, "width_px": 960, "height_px": 600, "variants": ("noon",)},
    "country": {
        "rate_hz": 10.0,
        "speed_mps": 14.0,
        "width_px": 960,
        "height_px": 600,
        "variants": ("noon",),
        "crown": 0.02,
    },
    "loop": {"rate_hz": 5.0, "speed_mps": 9.0, "width_px": 960, "height_px": 600, "variants": ("noon",), "laps": 2},
    "hall": {"rate_hz": 4.0, "speed_mps": 2.4, "width_px": 640, "height_px": 480, "variants": ("garage",), "laps": 2},
    "lot": {"rate_hz": 5.0, "speed_mps": 3.0, "width_px": 640, "height_px": 480, "variants": ("noon",), "laps": 1},
    "garage": {"rate_hz": 5.0, "speed_mps": 2.2, "width_px": 640, "height_px": 480, "variants": ("garage",)},
}
KINDS = ("road", "country", "loop", "garage", "lot")
_STREAM = {"garage": 0, "road": 1, "country": 3, "loop": 4, "hall": 5, "lot": 6}
"""Of random numbers, by kind; 2 is that of drives on maps."""
_TOURS = {"loop": loop_tour, "hall": hall_tour, "lot": lot_tour}
"""Kinds with a way of their own, which laps and stops decide."""
_EPOCHS = 10
"""Keeps the random numbers of changes apart from all others."""


def simulate(
    kind: str, seed: int, out: str | Path, config: SimulationConfig | None = None, rig: Rig | None = None
) -> Drive:
    """Render a seeded drive into the folder `out` and open it.

    Args:
        kind: `road`, `country` or `loop` (one front camera), `garage` or `lot` (four fisheyes). A garage is one
            straight aisle, or with `config.laps` a hall with rings of aisles and slots of three types.
        seed: everything random follows from it.
        out: folder, made if absent.
        config: size and errors of the drive.
        rig: other cameras; width and height of `config` then play no role.

    Raises:
        SemlocError: unknown kind or lighting, no frames.

    >>> small = sj.SimulationConfig(num_frames=1, width_px=96, height_px=60)
    >>> len(sj.simulate("road", 3, tmp / "road", small))
    1
    """
    config = checked(kind, config or SimulationConfig())
    look = _look(kind, config)
    key = [seed, _STREAM[look]]
    rng = np.random.default_rng(key)
    own = variation(key, config.drive, rng, has_own_pictures=look in _TOURS)
    tour = _tour(look, config, rng, own) if look in _TOURS else _stretch(kind, config, rng, own)
    world, changes = at_epoch(tour.world, [*key, _EPOCHS], config.epoch)
    if config.num_frames is None:
        num_frames = _USUAL_FRAMES if np.isinf(tour.end_s) else int(tour.end_s * config.rate_hz) + 1
        config = replace(config, num_frames=num_frames)
    elif (config.num_frames - 1) / config.rate_hz > tour.end_s:
        most = int(tour.end_s * config.rate_hz) + 1
        raise SemlocError(f"num_frames = {config.num_frames}: the whole drive has {most}; leave it out for all of them")
    if rig is None:
        rig = (surround_rig if kind in ("garage", "lot") else front_rig)(config.width_px, config.height_px)
    told = {"epoch": config.epoch, "drive": config.drive, **tour.told}
    name = f"{kind} seed {seed}"
    scene = world.scene()
    staging = Staging(
        kind=kind,
        seed=seed,
        scene=scene,
        motion=tour.motion,
        origin=_ORIGIN,
        map_name=name,
        told=told,
        changes=changes,
        has_gnss=tour.has_gnss,
        features=world.features,
    )
    return write_drive(Path(out), staging, rig, config, own)


def _look(kind: str, config: SimulationConfig) -> str:
    """What a kind looks like: a garage with laps is a hall of rings, one without them a straight aisle."""
    return "hall" if kind == "garage" and config.laps else kind


def _tour(look: str, config: SimulationConfig, rng: np.random.Generator, own: Variation) -> Tour:
    """The whole way of a look that has one."""
    wish = TourWish(own.speed(config.speed_mps), config.laps, config.wear_share, config.has_obstacles)
    return _TOURS[look](rng, own.rng, wish)


def _stretch(kind: str, config: SimulationConfig, rng: np.random.Generator, own: Variation) -> Tour:
    """A stretch of road or aisle, as long as the frames ask for."""
    world = _built(kind, config, rng, None if own.is_first else own.rng)
    sway_m = 0.0 if kind == "garage" else 0.15
    phases = own.rng.uniform(0.0, 2.0 * np.pi, 4)
    motion = VehicleMotion(world.path, world.surface, own.speed(config.speed_mps), sway_m, 0.15, phases)
    return Tour(world, motion, np.inf)


def _built(kind: str, config: SimulationConfig, rng: np.random.Generator, own: np.random.Generator | None) -> World:
    """The world of a kind at epoch 0, with the traffic of `own`."""
    num_frames = _USUAL_FRAMES if config.num_frames is None else config.num_frames
    length_m = config.speed_mps * ((num_frames - 1) / config.rate_hz + _LEAD_OUT_S)
    if kind == "road":
        return build_road(rng, length_m, config.speed_mps, config.wear_share, config.crown, own)
    if kind == "country":
        return build_country_road(rng, length_m, config.wear_share, config.crown, config.has_studs)
    return build_garage(rng, length_m, config.wear_share, own)


@dataclass(frozen=True)
class Staging:
    """A world and how the vehicle moves in it.

    Args:
        kind: word for meta.json.
        seed: of the drive, for meta.json.
        scene: the world.
        motion: of the vehicle.
        origin: place of the map frame on the earth; None where the map does not know it.
        map_name: name of the map.
        told: what else meta.json says.
        changes: content of changes.json.
        has_gnss: whether satellites are in view.
        features: of the map that are no elements.
    """

    kind: str
    seed: int
    scene: Scene
    motion: TrueMotion
    origin: GeoOrigin | None
    map_name: str
    told: dict = field(default_factory=dict)
    changes: dict = field(default_factory=lambda: {"epoch": 0, "since_epoch_0": [], "since_previous": []})
    has_gnss: bool = True
    features: tuple[dict, ...] = ()


def write_drive(out: Path, staging: Staging, rig: Rig, config: SimulationConfig, own: Variation) -> Drive:
    """Render a staged drive into the folder `out` and open it; what an interrupted run of it left there is used."""
    motion, rng = staging.motion, own.rng
    out.mkdir(parents=True, exist_ok=True)
    claim(out)
    rig = own.mounted(rig)
    recipe = _recipe(staging, config, rig)
    if is_begun(out) and not is_begun(out, recipe):
        raise SemlocError(f"{out}: holds the beginning of another drive; give a new folder, nothing is overwritten")
    keeps = own.is_restartable and is_begun(out)
    # The list of frames makes a drive of a folder: it goes first and comes back when everything is there.
    (out / "frames.csv").unlink(missing_ok=True)
    write_text(out / UNFINISHED, recipe)
    write_calibration(rig, out / "calib.yaml")
    _write_maps(out, staging, config.map_errors, rng)
    # Times count from the first frame; files count from the start of the logs. They are as the files state them: a
    # frame must not lie behind the last pose by a rounding.
    time_s = np.round(np.arange(config.num_frames) / config.rate_hz, 6)
    end_s = time_s[-1] + _LEAD_OUT_S
    plan = SensorPlan(config.sensors, config.imu_rate_hz, config.imu_offset_s, config.gps_bias_m, staging.has_gnss)
    sensors = write_sensor_logs(out, motion, -LEAD_IN_S, end_s, plan, staging.origin or _ORIGIN, rng)
    _write_truth(out, motion, time_s, rig)
    lightings = [LOOKS[config.variants[k * len(config.variants) // len(time_s)]] for k in range(len(time_s))]
    settings = PictureSettings(config.has_images, own.degradation(config.degradation), own.of_picture, keeps)
    write_pictures(out, staging.scene, motion, rig, time_s, lightings, settings)
    classes = CLASS_IDS | (OBSTACLE_IDS if config.has_obstacles else {})
    meta = {"classes": classes, "kind": staging.kind, "seed": staging.seed, "variants": list(config.variants)}
    meta |= {"sensors": sensors, **staging.told}
    write_text(out / "meta.json", json.dumps(meta, indent=1) + "\n")
    _write_frame_list(out, time_s, lightings)
    (out / UNFINISHED).unlink()
    return open_drive(out)


def _recipe(staging: Staging, config: SimulationConfig, rig: Rig) -> str:
    """What a drive follows from, as text."""
    cameras = [np.asarray(value).tolist() for value in jax.tree.leaves(rig)]
    made = {"kind": staging.kind, "seed": staging.seed, "map": staging.map_name, **staging.told}
    made |= {"config": repr(config), "cameras": cameras, "names": rig.names}
    return json.dumps(made, indent=1) + "\n"


def is_begun(out: Path, recipe: str | None = None) -> bool:
    """Whether an interrupted simulation lies in a folder, that of a recipe if one is given."""
    place = out / UNFINISHED
    return place.is_file() and (recipe is None or place.read_text() == recipe)


def checked(kind: str, config: SimulationConfig) -> SimulationConfig:
    """The configuration with the defaults of a kind of drive filled in.

    Raises:
        SemlocError: unknown kind or lighting, no frames, a speed or rate that is not positive, an impossible epoch.
    """
    if kind not in KINDS:
        raise SemlocError(f"unknown kind '{kind}'; expected one of {', '.join(KINDS)}")
    look = _look(kind, config)
    if config.num_frames is not None and config.num_frames < 1:
        raise SemlocError(f"num_frames = {config.num_frames}; expected at least 1")
    missing = {key: value for key, value in _DEFAULTS[look].items() if not getattr(config, key)}
    config = replace(config, **missing)
    for name in ("rate_hz", "speed_mps", "width_px", "height_px"):
        if not getattr(config, name) > 0:
            raise SemlocError(f"{name} = {getattr(config, name)}; expected a positive number")
    for name in ("epoch", "drive"):
        if not 0 <= getattr(config, name) <= _MOST_EPOCHS:
            raise SemlocError(f"{name} = {getattr(config, name)}; expected 0 to {_MOST_EPOCHS}")
    if not 0 <= config.laps <= _MOST_LAPS:
        raise SemlocError(f"laps = {config.laps}; expected 1 to {_MOST_LAPS}")
    if config.laps and look not in _TOURS:
        raise SemlocError(f"laps = {config.laps}: a {kind} has no laps; expected kind loop, garage or lot")
    if config.has_obstacles and look not in ("hall", "lot"):
        raise SemlocError(f"obstacles: a {kind} has no slots for them; expected kind lot, or garage with laps")
    if config.has_studs and kind != "country":
        raise SemlocError(f"studs: a {kind} has none; expected kind country")
    if not 0.0 <= config.crown <= 0.1:
        raise SemlocError(f"crown = {config.crown:g}; expected the fall of a road, 0 to 0.1: 0.02 is usual")
    unknown = [name for name in config.variants if name not in LOOKS]
    if unknown:
        raise SemlocError(f"unknown variant '{unknown[0]}'; expected some of {', '.join(LOOKS)}")
    return config


def _write_maps(out: Path, staging: Staging, errors: MapErrors, rng: np.random.Generator) -> None:
    elements, origin, name = staging.scene.elements, staging.origin, staging.map_name
    write_drive_geojson(SemanticMap(elements, origin, f"{name}, exact"), out / "map.geojson", staging.features)
    faulty, log = with_errors(elements, errors, rng)
    with_faults = SemanticMap(faulty, origin, f"{name}, with errors")
    write_drive_geojson(with_faults, out / "map_with_errors.geojson", staging.features)
    write_text(out / "map_errors_log.json", json.dumps(log, indent=1) + "\n")
    write_text(out / "changes.json", json.dumps(staging.changes, indent=1) + "\n")
    write_text(out / "element_ids.json", json.dumps(["none", *(element.id for element in elements)]) + "\n")


def _write_truth(out: Path, motion: TrueMotion, time_s: np.ndarray, rig: Rig) -> None:
    T_map_base = motion.poses(time_s)
    write_tum(Trajectory(time_s, T_map_base), out / "poses_body.tum")
    for name, T_base_cam in zip(rig.names, np.asarray(rig.T_base_cam), strict=True):
        write_tum(Trajectory(time_s, T_map_base @ T_base_cam), out / f"poses_cam_{name}.tum", f"camera {name}")


def _write_frame_list(out: Path, time_s: np.ndarray, lightings: list[Lighting | AnyLook]) -> None:
    rows = [f"{k:06d},{t:.6f},{light.name}" for k, (t, light) in enumerate(zip(time_s, lightings, strict=True))]
    write_text(out / "frames.csv", "\n".join(["frame,t,variant", *rows]) + "\n")

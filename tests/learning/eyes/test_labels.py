"""What the map says of an image: against a ray tracer, against exact projection, against draws of the pose."""

import numpy as np
import pytest
from scipy.stats import norm

import semloc_jax as sj
from semloc_jax.geometry import rigid
from semloc_jax.learning.eyes.labels import Labels, drawn_labels, with_kept
from semloc_jax.learning.eyes.shapes import seen_surfaces
from semloc_jax.learning.eyes.trust import ElementLooks
from semloc_jax.perception import load_class_table
from semloc_jax.perception.border_distance import BorderDistances
from semloc_jax.perception.networks.eyes import CELL_PX, REACH_PX, Said, eyes_table
from semloc_jax.structs import ElementClass

SIZE = (640, 400)
T = sj.planar_pose(2.6, -0.2, 0.02)
EXACT = 1e-8 * np.eye(6)


@pytest.fixture(scope="module")
def rig():
    camera = sj.camera_from_K([[400, 0, 319.5], [0, 400, 199.5], [0, 0, 1]], SIZE)
    return sj.Rig([camera], [sj.mounted((1.6, 0.0, 1.4), down_deg=4.0)], ["front"])


@pytest.fixture(scope="module")
def street():
    sides = [[[0, y, 0], [60, y, 0]] for y in (2.0, -2.0)]
    bar, post = [[14, -1.9, 0], [14, 1.9, 0]], [[17.0, 3.2, 0.0], [17.0, 3.2, 2.6]]
    plate = [[21.0, -3.4, 1.5], [21.0, -2.6, 1.5], [21.0, -2.6, 2.3], [21.0, -3.4, 2.3]]
    return sj.map_from_arrays(
        [
            ("lane_marking", sides[0]),
            ("lane_marking", sides[1]),
            ("stop_line", bar, {"width_m": 0.5}),
            ("pole", post, {"radius_m": 0.15, "radius_top_m": 0.15}),
            ("sign", plate, {"closed": True}),
        ]
    )


@pytest.fixture(scope="module")
def table(street):
    return eyes_table(load_class_table("drive"), street.labels)


def labels_of(street, rig, table, covariance=EXACT, trusted=None, hidden=None, scale=1.0, pose=T):
    elements = street.elements
    surfaces = seen_surfaces(elements, rig.cameras[0], pose, np.asarray(rig.T_base_cam)[0], covariance, 1e-4)
    is_trusted = np.ones(len(elements), bool) if trusted is None else trusted
    return drawn_labels(surfaces, elements, table, SIZE, scale, is_trusted, hidden)


def test_inside_is_what_a_ray_tracer_sees(street, rig, table):
    """Of the cells well inside or outside by the label, at most 2 in 1,000 are another class by rays of the pixels."""
    labels = labels_of(street, rig, table)
    mask = sj.render_masks(street, rig, T)[0]
    drive = load_class_table("drive")
    for k, channel in enumerate(table.channels):
        seen = np.isin(mask, drive.channels[drive.channel_index(channel.name)].mask_ids).astype(np.float32)
        share = seen.reshape(SIZE[1] // 2, 2, SIZE[0] // 2, 2).mean((1, 3))  # cells of two pixels
        judged = labels.known & (np.abs(labels.signed_px[k]) > 1.5)
        wrong = (share > 0.5) != (labels.signed_px[k] < 0.0)
        assert (labels.signed_px[k] < -1.0).sum() > 20, channel.name
        assert wrong[judged].mean() < 2e-3, channel.name


def zeros_of(column):
    """Places [px of the network's image] at which a column of cells crosses zero."""
    centres = (np.arange(len(column)) + 0.5) * CELL_PX - 0.5
    near = np.flatnonzero(np.diff(np.sign(column)) != 0)
    return [centres[i] - column[i] * CELL_PX / (column[i + 1] - column[i]) for i in near]


@pytest.mark.parametrize("scale", [1.0, pytest.param(2.0, marks=pytest.mark.slow)])
def test_borders_are_drawn_where_they_project(street, rig, table, scale):
    """The near and far edge of the bar in the column of its middle from 12 places: none is more than half a drawn pixel
    off, and the mean is right to 0.08 px of the network's image."""
    k = [channel.name for channel in table.channels].index("stop_line")
    errors = []
    for moved_m in np.linspace(0.0, 0.7, 12):
        pose = T @ sj.planar_pose(moved_m, 0.0)
        labels = labels_of(street, rig, table, scale=scale, pose=pose)
        for x in (13.75, 14.25):
            p_cam = rigid.inverse(pose @ np.asarray(rig.T_base_cam)[0]) @ [x, 0.0, 0.0, 1.0]
            u, v = (np.asarray(rig.cameras[0].project(p_cam[:3])[0]) + 0.5) * scale - 0.5
            zeros = zeros_of(labels.signed_px[k][:, int((u + 0.5) / CELL_PX)])
            errors.append(min((zero - v for zero in zeros), key=abs))
    assert np.abs(errors).max() < 0.3 and abs(np.mean(errors)) < 0.08


def test_sigma_is_the_spread_of_borders_over_poses(street, rig, table):
    """Against 200 draws of the pose: how far the near edge of the bar moves up and down in its middle."""
    sigma = np.array([0.10, 0.03, 0.005, 0.001, 0.002, 0.003])
    labels = labels_of(street, rig, table, np.diag(sigma**2))
    k = [channel.name for channel in table.channels].index("stop_line")
    rng = np.random.default_rng(0)
    rows = []
    for xi in rng.standard_normal((200, 6)) * sigma:
        p = rigid.inverse(T @ rigid.exp(xi) @ np.asarray(rig.T_base_cam)[0]) @ [13.75, 0.0, 0.0, 1.0]
        rows.append(float(rig.cameras[0].project(p[:3])[0][1]))
    row, column = int((np.mean(rows) + 0.5) / CELL_PX), SIZE[0] // 4
    assert labels.sigma_px[k][row, column] == pytest.approx(np.std(rows), rel=0.2)


def test_nothing_is_known_about_what_is_hidden_or_denied(street, rig, table):
    hidden = np.zeros(SIZE[::-1], bool)
    hidden[:, :100] = True
    labels = labels_of(street, rig, table, hidden=hidden)
    assert not labels.known[:, : 100 // 2].any() and labels.known[-20:, 160:].all()
    trusted = np.array([element.label != ElementClass.STOP_LINE for element in street.elements])
    denied = labels_of(street, rig, table, trusted=trusted)
    k = [channel.name for channel in table.channels].index("stop_line")
    whole = labels_of(street, rig, table)
    assert np.all(denied.signed_px[k] == REACH_PX), "what nobody believes is not drawn"
    assert not denied.known[whole.signed_px[k] < 3.0].any(), "and nobody is told that it is not there"


def test_elements_that_no_frame_shows_are_denied(street, rig, table):
    """The masks show everything but the bar: after five looks it teaches no more."""
    labels = labels_of(street, rig, table)
    k = [channel.name for channel in table.channels].index("stop_line")
    fields = labels.signed_px[None].copy()
    fields[0, k] = REACH_PX
    seen = BorderDistances(fields, 2, REACH_PX)
    place = rig.cameras[0], T, np.asarray(rig.T_base_cam)[0]
    surfaces = seen_surfaces(street.elements, *place, EXACT, 0.03)
    looks = ElementLooks()
    for _ in range(4):
        looks.look(surfaces, street.elements, seen, 0, table, 1.0)
    assert looks.is_trusted(street.elements).all(), "four looks are too few"
    looks.look(surfaces, street.elements, seen, 0, table, 1.0)
    expected = [element.label != ElementClass.STOP_LINE for element in street.elements]
    assert looks.is_trusted(street.elements).tolist() == expected and looks.num_distrusted == 1


def test_what_the_map_does_not_tell_is_kept():
    """The map tells the first class; the second and what moves stay as the network says, its sigma included."""
    known = np.ones((3, 4), bool)
    known[0, 0] = False
    labels = Labels(np.full((2, 3, 4), 5.0), np.full((2, 3, 4), 0.5), known, np.zeros((2, 3, 4), bool))
    said = Said(np.stack([np.full((3, 4), value) for value in (1.0, 7.0, 90.0)], -1), np.full((3, 4, 3), 0.7), 0.0)
    kept = with_kept(labels, (True, False), said)
    assert kept.signed_px[:, 1, 2].tolist() == [5.0, 7.0, REACH_PX]
    np.testing.assert_allclose(kept.sigma_px[:, 1, 2], [0.5, np.exp(0.7), np.exp(0.7)])
    assert kept.kept[:, 1, 2].tolist() == [False, True, True]
    assert kept.kept[:, 0, 0].all() and kept.signed_px[0, 0, 0] == 1.0, "nor does the map tell what is hidden"


def test_an_outline_is_drawn_whole(rig, table):
    """All that lies well inside the outline of a sign, seen from aside: not two triangles."""
    for center, along in (((12.0, 2.5, 1.9), (0.5, 0.8)), ((14.0, -1.0, 2.6), (0.05, 1.0))):
        half = 0.6 * np.array([*along, 0.0]) / np.hypot(*along)
        up = np.array([0.0, 0.0, 0.6])
        ring = np.array([center] * 4) + [half - up, -half - up, -half + up, half + up]
        street = sj.map_from_arrays([("sign", ring, {"closed": True}), ("lane_marking", [[0, 2, 0], [60, 2, 0]])])
        labels = labels_of(street, rig, table)
        inverse = rigid.inverse(T @ np.asarray(rig.T_base_cam)[0])
        k = [channel.name for channel in table.channels].index("sign")
        for share in ((0, 0), (0.5, 0), (-0.5, 0), (0, 0.5), (0, -0.5)):
            p = (inverse @ [*(np.array(center) + share[0] * half + share[1] * up), 1.0])[:3]
            u, v = np.asarray(rig.cameras[0].project(p)[0])
            assert labels.signed_px[k][int((v + 0.5) / CELL_PX), int((u + 0.5) / CELL_PX)] < -1.0, (center, share)


def test_a_class_that_is_not_in_view_is_surely_not_there(street, rig, table):
    """Looking back, no plate is in view: its distance is beyond the reach, and not unsure by as much."""
    labels = labels_of(street, rig, table, pose=T @ sj.planar_pose(30.0, 0.0))
    k = [channel.name for channel in table.channels].index("sign")
    assert np.all(labels.signed_px[k] == REACH_PX) and labels.sigma_px[k].max() < 1.0


def test_what_is_too_thin_to_be_seen_teaches_nothing(rig, table):
    """Two posts of 6 cm, at 15 and 60 m (1.8 and 0.4 px): the near one is drawn, the far one is not known."""
    posts = [("pole", [[x, 3.0, 0.0], [x, 3.0, 2.0]], {"radius_m": 0.03, "radius_top_m": 0.03}) for x in (15.0, 60.0)]
    labels = labels_of(sj.map_from_arrays([*posts, ("lane_marking", [[0, 2, 0], [60, 2, 0]])]), rig, table)
    k = [channel.name for channel in table.channels].index("pole")
    inverse = rigid.inverse(T @ np.asarray(rig.T_base_cam)[0])
    u, v = (np.array([rig.cameras[0].project((inverse @ [x, 3.0, 1.0, 1.0])[:3])[0] for x in (15.0, 60.0)]).T).astype(
        int
    )
    rows, columns = v // int(CELL_PX), u // int(CELL_PX)
    assert abs(labels.signed_px[k, rows[0], columns[0]]) < 2.0 and labels.known[rows[0], columns[0]]
    assert labels.signed_px[k, rows[1], columns[1]] > 10.0 and not labels.known[rows[1], columns[1]]


def test_a_post_that_the_pose_does_not_hold_is_not_taught_away(street, rig, table):
    """A post 7.8 px wide. Labels drawn at poses turned by 1.7 deg (12 px) say in their median that nothing stands where
    it is seen; so they say nothing, and those of poses turned by 0.3 deg that it is there."""
    k = [channel.name for channel in table.channels].index("pole")
    p = rigid.inverse(T @ np.asarray(rig.T_base_cam)[0]) @ [17.0, 3.2, 1.3, 1.0]
    column, row = (np.asarray(rig.cameras[0].project(p[:3])[0]) / CELL_PX).astype(int)
    turns_rad = 0.03 * norm.ppf((np.arange(21) + 0.5) / 21)
    poses = [T @ rigid.exp(np.array([0, 0, 0, 0, 0, turn])) for turn in turns_rad]
    drawn = [labels_of(street, rig, table, pose=pose).signed_px[k, row, column] for pose in poses]
    assert np.median(drawn) > 2.0
    for turn, is_told in ((0.03, False), (0.005, True)):
        labels = labels_of(street, rig, table, np.diag([1e-4, 1e-4, 1e-4, 1e-4, 1e-4, turn]) ** 2)
        assert bool(labels.known[row, column]) == is_told
        assert (labels.signed_px[k, row, column] < -2.0) == is_told

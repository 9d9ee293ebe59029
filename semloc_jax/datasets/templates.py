"""What each file of a folder recording looks like, as text to copy (room: datasets; host).

In: nothing, or names of cameras. Out: examples of calib.yaml, classes.yaml and of the tables of sensors.
Errors quote them, `semloc init` writes them. Numbers that only the owner knows are words, which no reader accepts.
"""

import re
from collections.abc import Sequence

COLUMNS = {
    "times.csv": "frame,t\n000,1700000000.000\n001,1700000000.100\n",
    "gps.csv": "t,lat_deg,lon_deg,alt_m\n1700000000.000,48.137154,11.576124,519.2\n",
    "wheel_odom.csv": "t,v_m_s,yaw_rate_rad_s\n1700000000.000,8.31,0.012\n",
    "imu.csv": "t,gx_rad_s,gy,gz,ax_m_s2,ay,az\n1700000000.000,0.001,-0.002,0.012,0.1,0.0,9.81\n",
}
"""First lines of each table."""

GNSS_COLUMNS = (
    "t, lat_deg, lon_deg, alt_m (degrees; alt_m may be left out) or t, east_m, north_m, up_m, sigma_e, sigma_n, "
    "sigma_u (metres of the map)"
)

_CAMERA = """cam{index}:
  name: {name}                 # the name of its folder: images/{name}/, masks/{name}/
  camera_model: pinhole
  intrinsics: [{intrinsics}]  # fx fy cx cy in pixels; the centre of the top-left pixel is (0, 0)
  distortion_model: radtan      # radtan: k1 k2 p1 p2 [k3] of OpenCV; equidistant: k1 k2 k3 k4 of a fisheye; none
  distortion_coeffs: [{distortion}]
  resolution: [{width}, {height}]
  mounted:                      # or T_body_cam, 4x4: camera (x right, y down, z forward) to vehicle (x forward, y left)
    position_m: [X_FORWARD, Y_LEFT, Z_UP]  # the lens from the rear axle on the ground, measured with a rule
    yaw_deg: 0.0                # 0 looks ahead, 90 to the left, -90 to the right, 180 back
    down_deg: 0.0               # tilt towards the road; check-calib draws the horizon where this puts it
    roll_deg: 0.0
"""

CLASSES = """# What the ids in the masks mean; semloc ... --class-table classes.yaml
name: mine
ids: {background: 0, lane_marking: LANE_ID, pole: POLE_ID, car: CAR_ID}
channels:  # map classes: lane_marking stop_line crosswalk road_mark slot_line pole sign traffic_light pillar curb ...
  - {name: lane_marking, masks: [lane_marking], classes: [lane_marking, stop_line, crosswalk, road_mark]}
  - {name: pole, masks: [pole], classes: [pole]}
dynamic: [car]  # hides the map; never compared with it
"""


_WORDS = ("FX", "FY", "CX", "CY", "K1", "K2", "P1", "P2", "X_FORWARD", "Y_LEFT", "Z_UP", "WIDTH", "HEIGHT")
_WORDS += ("LANE_ID", "POLE_ID", "CAR_ID")


def unfilled(text: str) -> list[str]:
    """The words of a template that nobody has replaced yet, in their order."""
    bare = re.sub(r"#.*", "", text)
    return [word for word in _WORDS if re.search(rf"\b{word}\b", bare)]


def calibration_template(
    names: Sequence[str],
    sizes_px: Sequence[tuple[int, int] | None],
    intrinsics_px: Sequence[float] = (),
    distortion: Sequence[float] = (),
) -> str:
    """A calib.yaml to fill in.

    Args:
        names: Cameras.
        sizes_px: Width and height of their images, None where unknown.
        intrinsics_px: fx, fy, cx, cy where they are known, of the one camera.
        distortion: Its coefficients k1 k2 p1 p2 [k3] of OpenCV where they are known.
    """
    head = "# Replace every word in capitals; semloc check-calib FOLDER shows whether it is right.\n"
    cameras = []
    for index, (name, size) in enumerate(zip(names, sizes_px, strict=True)):
        width, height = size or ("WIDTH", "HEIGHT")
        known = {
            "intrinsics": ", ".join(f"{value:.10g}" for value in intrinsics_px) or "FX, FY, CX, CY",
            "distortion": ", ".join(f"{value:.10g}" for value in distortion) or "K1, K2, P1, P2",
        }
        cameras.append(_CAMERA.format(index=index, name=name, width=width, height=height, **known))
    return head + "".join(cameras)

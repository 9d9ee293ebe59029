"""A small Apollo HD map in text form, made by hand."""

EAST, NORTH = 587000.0, 4141000.0
"""UTM zone 10, in Sunnyvale."""

UTM = "+proj=utm +zone=10 +ellps=WGS84 +datum=WGS84 +units=m +no_defs"

ABOUT = "+proj=tmerc +lat_0={37.413082} +lon_0={-122.013332} +k={0.9999999996} +ellps=WGS84 +no_defs"


def points(*xy, z=None):
    height = "" if z is None else f" z: {z}"
    return " ".join(f"point {{ x: {EAST + x} y: {NORTH + y}{height} }}" for x, y in xy)


def curve(*xy, z=None):
    return f"segment {{ s: 0 line_segment {{ {points(*xy, z=z)} }} length: 9 }}"


def boundary(side, y, kinds, virtual="false"):
    types = " ".join(f"boundary_type {{ s: {s} types: {kind} }}" for s, kind in kinds)
    return f"{side}_boundary {{ curve {{ {curve((0, y), (50, y), (100, y))} }} virtual: {virtual} {types} }}"


def lane(name, left, right):
    return f'lane {{\n id {{ id: "{name}" }}\n {left}\n {right}\n left_sample {{ s: 0.0 width: 1.75 }} }}\n'


DIVIDER = [(0, "DOTTED_WHITE")]

MAP = (
    '# made by hand\nheader { version: "1.5" projection { proj: "PROJ" } }\n'
    + lane("a", boundary("left", 3.5, [(0, "DOUBLE_YELLOW")]), boundary("right", 0.0, DIVIDER))
    + lane("b", boundary("left", 0.05, DIVIDER), boundary("right", -3.5, [(0, "SOLID_WHITE"), (60, "CURB")]))
    + lane("c", boundary("left", 20.0, [(0, "SOLID_WHITE")], "true"), boundary("right", 16.0, [(0, "UNKNOWN")]))
    + f'crosswalk {{ id {{ id: "x" }} polygon {{ {points((60, -3.5), (64, -3.5), (64, 3.5), (60, 3.5))} }} }}\n'
    + f'stop_sign {{ id {{ id: "2" }} stop_line {{ {curve((55, -3.5), (55, 0))} }} }}\n'
    + f'signal < id < id: "s" > boundary < {points((70, -5), (70, -4.6), z=5.0)} '
    + f"{points((70, -5), (70, -4.6), z=6.0)} >"
    + f" type: MIX_3_VERTICAL stop_line < {curve((55, -3.5), (55, 0))} > >\n"
    + 'parking_space { id { id: "p" } heading: 1.5707963 '
    + f"polygon {{ {points((10, 12), (8, 12), (8, 7), (10, 7))} }} }}"
    + '\nspeed_bump { id { id: "h" } }\noverlap { id { id: "o" } object { id { id: "a" } } }\n'
)


def write(folder, projection=UTM, text=MAP):
    path = folder / "base_map.txt"
    path.write_text(text.replace("PROJ", projection))
    return path

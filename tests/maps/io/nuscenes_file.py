"""A small nuScenes map expansion, written by hand after the format's description."""


def expansion() -> dict:
    """A divider of 60 m, dashed for 40 m and then double solid; a crosswalk, two stop areas and a light."""
    places = {"a": (0, 0), "b": (40, 0), "c": (60, 0), "p": (50, -4), "q": (53, -4), "r": (53, 4), "s": (50, 4)}
    segments = [
        {"node_token": "a", "segment_type": "SINGLE_DASHED_WHITE"},
        {"node_token": "b", "segment_type": "DOUBLE_SOLID_YELLOW"},
        {"node_token": "c", "segment_type": "NIL"},
    ]
    return {
        "version": "1.3",
        "node": [{"token": token, "x": x, "y": y} for token, (x, y) in places.items()],
        "line": [{"token": "L", "node_tokens": ["a", "b", "c"]}, {"token": "T", "node_tokens": ["p", "q"]}],
        "polygon": [{"token": "P", "exterior_node_tokens": ["p", "q", "r", "s"], "holes": []}],
        "lane_divider": [{"token": "D", "line_token": "L", "lane_divider_segments": segments}],
        "road_divider": [{"token": "R", "line_token": "L", "road_segment_token": None}],
        "ped_crossing": [{"token": "X", "polygon_token": "P"}],
        "stop_line": [
            {"token": "S", "polygon_token": "P", "stop_line_type": "TRAFFIC_LIGHT"},
            {"token": "U", "polygon_token": "P", "stop_line_type": "TURN_STOP"},
        ],
        "traffic_light": [{"token": "G", "line_token": "T", "traffic_light_type": "VERTICAL"}],
    }

"""Motion, measured poses and satellite fixes become one pose over time (room)."""

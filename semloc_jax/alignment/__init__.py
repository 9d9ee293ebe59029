"""One frame: masks and a map become poses with a verdict (room)."""

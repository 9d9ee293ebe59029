"""Time goes forward in a map: frames one by one, or a whole drive tracked (room)."""

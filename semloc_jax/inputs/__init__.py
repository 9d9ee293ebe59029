"""A drive, its map, masks, cameras and prior, opened and checked together (room)."""

"""Pictures of maps, poses and costs (room: viz); the only place with matplotlib, every picture a Figure or an array."""

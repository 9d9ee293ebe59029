"""What the rest runs on: environment of JAX, compiled programs on disk, memory, worker processes (room)."""

"""What JAX runs on: environment, compiled programs on disk, memory (room)."""

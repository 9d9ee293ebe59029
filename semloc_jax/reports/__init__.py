"""The folder of a run: tables, metrics and pictures, for the command line and notebooks alike (room)."""

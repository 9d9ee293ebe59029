"""Files, taken from anybody and left to anybody (room: ground; host): the one door to the disk.

In: paths and names as given. Out: places inside the output folder, files that are whole, content within limits.
Readers take their limits from here, writers their paths, whole files and claims, caches their sealed entries.
"""

from semloc_jax.storage.garbage import rare_collection
from semloc_jax.storage.leftovers import sweep, sweep_once, temporary_prefix
from semloc_jax.storage.limits import (
    FARTHEST_M,
    MOST_PIXELS,
    decompressed,
    json_document,
    npy_array,
    npz_arrays,
    npz_names,
    reading,
    require_room,
)
from semloc_jax.storage.output import claim, file_name, is_plain_name, output_path, release_claims
from semloc_jax.storage.sealed import others_can_write, private_folder, read_sealed, write_sealed
from semloc_jax.storage.writing import (
    append_line,
    making,
    remove_folder,
    whole_lines,
    write_bytes,
    write_npz,
    write_text,
    writing,
)

__all__ = [
    "FARTHEST_M",
    "MOST_PIXELS",
    "append_line",
    "claim",
    "decompressed",
    "file_name",
    "is_plain_name",
    "json_document",
    "making",
    "npy_array",
    "npz_arrays",
    "npz_names",
    "others_can_write",
    "output_path",
    "private_folder",
    "read_sealed",
    "rare_collection",
    "reading",
    "release_claims",
    "remove_folder",
    "require_room",
    "sweep",
    "sweep_once",
    "temporary_prefix",
    "whole_lines",
    "write_bytes",
    "write_npz",
    "write_sealed",
    "write_text",
    "writing",
]

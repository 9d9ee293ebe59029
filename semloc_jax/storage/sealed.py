"""Cache entries that nobody but this user can have written (room: ground; host).

In: bytes that are code once they are loaded (compiled programs, kernels). Out: the same bytes, or None.
An entry is its content behind a keyed hash (HMAC-SHA256) of its name and content. The key is 32 random bytes in a file
that only this user can read. Nothing of an entry is looked at, let alone unpickled or loaded, before its hash is right.
"""

import contextlib
import functools
import hashlib
import hmac
import logging
import os
import secrets
import stat
import tempfile
from pathlib import Path

from semloc_jax.storage.leftovers import sweep_once, temporary_prefix
from semloc_jax.storage.writing import write_bytes

_MAGIC = b"semloc-sealed-1\n"
_KEY_BYTES, _HASH_BYTES = 32, 32
_LARGEST_BYTES = 1 << 30
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
_log = logging.getLogger(__name__)


def home_folder() -> Path:
    """Where this package keeps files of the user: XDG_CACHE_HOME, else ~/.cache."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()) / "semloc_jax"


def others_can_write(folder: Path) -> bool:
    """Whether a folder belongs to another user, or lets others write; False where there is none yet."""
    try:
        found = folder.stat()
    except OSError:
        return False
    return _is_foreign(found) or bool(os.name == "posix" and found.st_mode & _OTHERS_WRITE)


def private_folder(folder: Path) -> bool:
    """Make a folder that only this user can enter, or make ours such; whether it is one now.

    A link, and a folder of another user, are refused.
    """
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
        if not stat.S_ISDIR(found.st_mode) or _is_foreign(found):
            _log.warning("%s: belongs to another user or is a link; nothing is kept there", folder)
            return False
        if os.name == "posix" and found.st_mode & 0o077:
            folder.chmod(0o700)
    except OSError:
        return False
    return True


def write_sealed(path: Path, content: bytes) -> bool:
    """Keep bytes under a name; whether that was possible (a full or read-only disk, no private folder: no)."""
    key = _key() if private_folder(path.parent) else None
    if key is None:
        return False
    try:
        write_bytes(path, _MAGIC + _seal(key, path.name, content) + content)
    except OSError:
        return False
    return True


def read_sealed(path: Path) -> bytes | None:
    """The bytes that this user kept under the name; None where there are none.

    An entry that was planted, damaged, cut short or renamed is removed with one line of notice.
    """
    try:
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0))
    except FileNotFoundError:
        return None
    except OSError as error:
        return _refuse(path, error.strerror or "cannot be read")
    with os.fdopen(handle, "rb") as file:
        found = os.fstat(file.fileno())
        if not stat.S_ISREG(found.st_mode) or _is_foreign(found) or found.st_size > _LARGEST_BYTES:
            return _refuse(path, "is no file of this user")
        content = file.read()
    key = _key() if private_folder(path.parent) else None
    if key is None:
        return None
    head = len(_MAGIC) + _HASH_BYTES
    seal, body = content[len(_MAGIC) : head], content[head:]
    if not content.startswith(_MAGIC) or not hmac.compare_digest(seal, _seal(key, path.name, body)):
        return _refuse(path, "does not carry this user's seal")
    return body


def _seal(key: bytes, name: str, content: bytes) -> bytes:
    sealed = hmac.new(key, digestmod=hashlib.sha256)
    sealed.update(len(name.encode()).to_bytes(4, "little") + name.encode())
    sealed.update(content)
    return sealed.digest()


def _refuse(path: Path, why: str) -> None:
    _log.warning("cache entry %s: %s; it is made anew", path, why)
    with contextlib.suppress(OSError):  # it is not looked at in any case
        path.unlink(missing_ok=True)


def _is_foreign(found: os.stat_result) -> bool:
    return os.name == "posix" and found.st_uid != os.geteuid()


def _key() -> bytes | None:
    return _key_in(home_folder() / "seal")


@functools.cache
def _key_in(folder: Path) -> bytes | None:
    """The key of this user, made on first use; None where it cannot be kept secret."""
    if not private_folder(folder):
        return None
    path = folder / "key"
    try:
        if not path.exists():
            _make_key(path)
        found = path.lstat()
        if not stat.S_ISREG(found.st_mode) or _is_foreign(found) or (os.name == "posix" and found.st_mode & 0o077):
            _log.warning("%s: others can read it; nothing is kept in the cache; remove it", path)
            return None
        key = path.read_bytes()
    except OSError:
        return None
    return key if len(key) == _KEY_BYTES else None


def _make_key(path: Path) -> None:
    """Write a new key whole, unless another process was faster."""
    sweep_once(path.parent)
    handle, partial = tempfile.mkstemp(prefix=temporary_prefix(path.name), dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(secrets.token_bytes(_KEY_BYTES))
        with contextlib.suppress(FileExistsError):
            os.link(partial, path)
    finally:
        os.unlink(partial)

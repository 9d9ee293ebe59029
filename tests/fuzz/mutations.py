"""Damage to files: to their bytes, and to what they hold; knows formats from their standards, not from our readers."""

import gzip
import json
import random
import re
import sqlite3
import struct
import tempfile
import zipfile
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from xml.etree import ElementTree

NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
ODD_TEXTS = (
    *("0", "-0", "-1", "nan", "inf", "-inf", "1e300", "-1e308", "1e-320", "4e6", "9" * 25, "2147483648", "0x10"),
    *("", "null", "true", "abc", "[]", "{}", "../../../x", "/etc/passwd", "\x00", "é" * 300, "a,b", '"', "1 2"),
)
ODD_VALUES = (
    *(None, True, False, 0, -1, 1e308, 1e-320, 4e6, 2**63, float("nan"), float("inf"), "", "abc", "../../x"),
    *([], {}, [[]], [None], {"a": None}, "x" * 5000, [0] * 50),
)
DEPTH = 3000


def mutate(content: bytes, kind: str, rng: random.Random) -> bytes:
    """The content with one to four faults; `kind` is a suffix such as `.json`."""
    structured = STRUCTURED.get(kind, _text)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        act: Callable = structured if rng.random() < 0.7 else _bytes
        try:
            content = act(content, rng)
        except Exception:  # damage of before may leave nothing that can be parsed: then bytes are damaged
            content = _bytes(content, rng)
    return content


def _bytes(content: bytes, rng: random.Random) -> bytes:
    if not content:
        return rng.randbytes(20)
    start = rng.randrange(len(content))
    end = min(len(content), start + rng.choice((1, 2, 8, 64, 1000)))
    part = content[start:end]
    kind = rng.randrange(7)
    if kind == 0:
        return content[:start]
    middle = (
        bytes(b ^ 1 << rng.randrange(8) for b in part),
        b"",
        part * rng.choice((2, 50)),
        b"\0" * len(part),
        b"\xff" * len(part),
        rng.randbytes(len(part)),
    )[kind - 1]
    return content[:start] + middle + content[end:]


def _text(content: bytes, rng: random.Random) -> bytes:
    """Numbers, lines and cells."""
    numbers = list(NUMBER.finditer(content)) if len(content) < 2_000_000 else []
    kind = rng.randrange(6)
    if numbers and kind < 3:
        found = rng.choice(numbers)
        other = rng.choice(numbers).group() if kind == 2 else rng.choice(ODD_TEXTS).encode()
        return content[: found.start()] + other + content[found.end() :]
    lines = content.split(b"\n")
    at = rng.randrange(len(lines))
    if kind == 3:
        del lines[at]
    elif kind == 4:
        lines.insert(rng.randrange(len(lines)), lines[at])
    else:
        cells = lines[at].split(b",") if b"," in lines[at] else lines[at].split(b" ")
        cells[rng.randrange(len(cells))] = rng.choice(ODD_TEXTS).encode()
        lines[at] = (b"," if b"," in lines[at] else b" ").join(cells)
    return b"\n".join(lines)


def _json(content: bytes, rng: random.Random) -> bytes:
    if rng.random() < 0.02:
        return b"[" * DEPTH + b"]" * DEPTH
    root = {"root": json.loads(content)}
    holder, key = root, "root"
    while True:
        here = holder[key]
        steps = list(here) if isinstance(here, dict) else list(range(len(here))) if isinstance(here, list) else []
        if not steps or rng.random() < 0.15:
            break
        holder, key = here, rng.choice(steps)
    kind = rng.randrange(4)
    if kind == 0 and holder is not root:
        del holder[key]
    elif kind == 1 and isinstance(holder, list):
        holder.insert(key, holder[key])
    elif kind == 2 and isinstance(holder, dict) and holder is not root:
        holder[rng.choice(ODD_TEXTS)] = holder.pop(key)
    else:
        holder[key] = rng.choice(ODD_VALUES)
    return json.dumps(root["root"]).encode()


def _xml(content: bytes, rng: random.Random) -> bytes:
    root = ElementTree.fromstring(content)
    parents = [(parent, child) for parent in root.iter() for child in parent]
    parent, child = rng.choice(parents)
    kind = rng.randrange(5)
    if kind == 0:
        parent.remove(child)
    elif kind == 1:
        parent.insert(0, child)
    elif kind == 2:
        child.clear()
    elif child.attrib:
        name = rng.choice(list(child.attrib))
        if kind == 3:
            child.attrib[name] = rng.choice(ODD_TEXTS).replace("\x00", "0")
        else:
            del child.attrib[name]
    return ElementTree.tostring(root)


def _sqlite(content: bytes, rng: random.Random) -> bytes:
    with tempfile.NamedTemporaryFile(suffix=".db") as file:
        Path(file.name).write_bytes(content)
        connection = sqlite3.connect(file.name, isolation_level=None)
        tables = [row[0] for row in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        table = rng.choice([name for name in tables if not name.startswith(("sqlite_", "rtree_"))])
        column = rng.choice([row[1] for row in connection.execute(f'PRAGMA table_info("{table}")')])
        odd = rng.choice(
            (None, -1, 0, 2**62, 1e308, float("inf"), "", "abc", "../..", b"", b"GP\0\1", rng.randbytes(40))
        )
        where = "" if rng.random() < 0.2 else " WHERE rowid % 7 = 1"
        for (trigger,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'").fetchall():
            connection.execute(f'DROP TRIGGER "{trigger}"')
        connection.execute(f'UPDATE OR IGNORE "{table}" SET "{column}" = ?{where}', (odd,))
        connection.close()
        return Path(file.name).read_bytes()


def _gzip(content: bytes, rng: random.Random) -> bytes:
    if rng.random() < 0.05:
        return gzip.compress(bytes(80_000_000), 1)
    return gzip.compress(_bytes(gzip.decompress(content), rng))


def _npz(content: bytes, rng: random.Random) -> bytes:
    made = BytesIO()
    with zipfile.ZipFile(BytesIO(content)) as given, zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as out:
        names = given.namelist()
        hit = rng.choice(names)
        for name in names:
            part = given.read(name)
            if name == hit and rng.random() < 0.5:
                part = _bytes(part, rng)
            elif name == hit:  # the head states more than there is
                part = re.sub(rb"'shape': \([^)]*\)", b"'shape': (%d,)" % rng.choice((0, 7, 10**9, 10**18)), part)
            if not (name == hit and rng.random() < 0.1):
                out.writestr(name, part)
    return made.getvalue()


def _binary(content: bytes, rng: random.Random) -> bytes:
    """A number in its binary form where another was: counts, lengths, coordinates."""
    form = rng.choice(("<d", "<d", ">d", "<f", "<I", ">I", "<Q", "<H"))
    odd = (0, -1, 1e308, 4e6, float("nan"), float("inf"), 1e-320) if form[1] in "df" else (0, 1, 0x7F, 0xFFFF)
    value = rng.choice(odd)
    if form == "<f" and abs(value) > 1e38:
        value = float("inf")
    if form[1] in "IQ" and rng.random() < 0.5:
        value = rng.choice((2**31 - 1, 2**31, 2**32 - 1))
    part = struct.pack(form, value)
    start = rng.randrange(max(1, (len(content) - len(part)) // 4)) * 4
    return content[:start] + part + content[start + len(part) :]


def _feather(content: bytes, rng: random.Random) -> bytes:
    """One value, or the type or name of a column of an Arrow table."""
    import pyarrow as pa
    from pyarrow import feather

    table = feather.read_table(BytesIO(content)).to_pydict()
    name = rng.choice(list(table))
    kind = rng.randrange(5)
    if kind == 0:
        del table[name]
    elif kind == 1:
        table[rng.choice(ODD_TEXTS)] = table.pop(name)
    elif kind == 2:
        table[name] = [str(value) for value in table[name]]
    elif kind == 3:
        table = {key: values[: rng.randrange(2)] for key, values in table.items()}
    else:
        row = rng.randrange(len(table[name]))
        is_text = isinstance(table[name][row], str)
        odd = rng.choice(ODD_TEXTS) if is_text else rng.choice((None, 0, -1, 10**12, 1e308, float("nan")))
        table[name][row] = type(table[name][row])(odd) if odd is not None and odd == odd else odd
    made = BytesIO()
    feather.write_feather(pa.table(table), made)
    return made.getvalue()


def _yaml(content: bytes, rng: random.Random) -> bytes:
    import yaml

    if rng.random() < 0.4:
        return _text(content, rng)
    text = content.decode()
    head = "%YAML:1.0\n---\n" if text.startswith("%YAML:1.0") else ""
    values = json.dumps(yaml.safe_load(text.removeprefix(head)))
    return head.encode() + _json(values.encode(), rng)


STRUCTURED: dict[str, Callable[[bytes, random.Random], bytes]] = {
    ".json": _json,
    ".geojson": _json,
    ".osm": _xml,
    ".xodr": _xml,
    ".xml": _xml,
    ".gpkg": _sqlite,
    ".db3": _sqlite,
    ".gz": _gzip,
    ".npz": _npz,
    ".npy": _binary,
    ".shp": _binary,
    ".shx": _binary,
    ".dbf": _text,
    ".bag": _binary,
    ".mcap": _binary,
    ".avi": _binary,
    ".png": _binary,
    ".onnx": _binary,
    ".feather": _feather,
    ".yaml": _yaml,
}

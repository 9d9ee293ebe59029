"""The part of OpenStreetMap XML that Lanelet2 uses, read as a stream (room: maps; host).

In: a path. Out: OsmFile with nodes, ways and the references of relations.
Document types, and with them entity bombs, are refused.
"""

from dataclasses import dataclass, field
from pathlib import Path
from xml.etree.ElementTree import ParseError, XMLParser

from semloc_jax.errors import SemlocError

_CHUNK_BYTES = 1 << 16
_PLACE = ("lat", "lon", "ele", "local_x", "local_y", "mgrs_code")
_OF_NODES = ("id", *_PLACE, "action", "visible")
_NONE: list = []
"""References of every node."""


@dataclass(slots=True)
class OsmItem:
    """A node, way or relation.

    Attributes:
        attributes: XML attributes (id, lat, lon ...).
        tags: key -> value.
        references: node ids of a way, or (type, id, role) of the members of a relation.
    """

    attributes: dict[str, str]
    tags: dict[str, str] = field(default_factory=dict)
    references: list = field(default_factory=list)


@dataclass
class OsmFile:
    """Everything that is not deleted, by id, and the attributes of the root."""

    attributes: dict[str, str] = field(default_factory=dict)
    nodes: dict[str, OsmItem] = field(default_factory=dict)
    ways: dict[str, OsmItem] = field(default_factory=dict)
    relations: dict[str, OsmItem] = field(default_factory=dict)


def _place(attributes: dict[str, str]) -> OsmItem:
    """Returns a node with its position, tags and attributes in one table.

    There are millions of nodes; the author, time and version that editors write are dropped.
    """
    kept = {key: attributes[key] for key in _OF_NODES if key in attributes}
    return OsmItem(kept, kept, _NONE)


class _Target:
    """Receives the elements of the XML stream; keeps no tree."""

    def __init__(self, name: str):
        self.file = OsmFile()
        self._name = name
        self._item: OsmItem | None = None
        self._saw_root = False
        self._stores = {"node": self.file.nodes, "way": self.file.ways, "relation": self.file.relations}

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        raise SemlocError(f"map {self._name}: declares a document type; expected plain OSM XML: remove the <!DOCTYPE>")

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        if not self._saw_root and tag != "osm":
            raise SemlocError(f"map {self._name}: root element <{tag}>; expected <osm>, the format of Lanelet2")
        if not self._saw_root:
            self.file.attributes = attributes
        self._saw_root = True
        if tag in self._stores:
            self._item = _place(attributes) if tag == "node" else OsmItem(attributes)
        elif self._item is None:
            return
        elif self._item.references is _NONE:
            if tag == "tag" and attributes.get("k") in _PLACE:
                self._item.tags[attributes["k"]] = attributes.get("v", "")
        elif tag == "tag":
            self._item.tags[attributes.get("k", "")] = attributes.get("v", "")
        elif tag == "nd":
            self._item.references.append(attributes.get("ref", ""))
        elif tag == "member":
            self._item.references.append(tuple(attributes.get(key, "") for key in ("type", "ref", "role")))

    def end(self, tag: str) -> None:
        if tag not in self._stores or self._item is None:
            return
        item, self._item = self._item, None
        action, visible = item.attributes.pop("action", ""), item.attributes.pop("visible", "")
        if action == "delete" or visible == "false":
            return
        if "id" not in item.attributes:
            raise SemlocError(f"map {self._name}: a <{tag}> without id; expected an id on every {tag}")
        self._stores[tag][item.attributes["id"]] = item

    def close(self) -> OsmFile:
        return self.file


def read_osm(path: str | Path) -> OsmFile:
    """Returns the nodes, ways and relations of an OSM file.

    Raises:
        SemlocError: not well-formed, not OSM, or with a document type.
    """
    path = Path(path)
    parser = XMLParser(target=_Target(path.name))
    try:
        with path.open("rb") as stream:
            while chunk := stream.read(_CHUNK_BYTES):
                parser.feed(chunk)
        return parser.close()
    except (ParseError, ValueError, LookupError) as error:
        raise SemlocError(f"map {path.name}: not well-formed XML ({error}); is the file complete?") from error

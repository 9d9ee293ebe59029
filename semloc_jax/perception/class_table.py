"""What the ids in a mask mean (room: perception; host).

In: a preset name or a YAML file. Out: ClassTable, the channels of the cost maps, and a report on how it fits a mask.
"""

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import yaml

from semloc_jax.errors import SemlocError
from semloc_jax.storage import reading
from semloc_jax.structs import ElementClass

_PRESETS = Path(__file__).parent / "class_tables"
UNLABELED_ID = 255
"""Ignored in every mask, whatever the table says."""
_MAX_SHARE = 0.35
"""No landmark class covers more of a set of masks."""


@dataclass(frozen=True)
class Channel:
    """One binary layer of a mask and the map classes that may be seen in it."""

    name: str
    mask_ids: tuple[int, ...]
    classes: tuple[ElementClass, ...]


@dataclass(frozen=True)
class TableReport:
    """How a class table fits a set of masks."""

    share: dict[str, float]
    """Share of all pixels for each channel."""
    problems: tuple[str, ...]
    """One sentence for each thing that looks wrong; empty if the table fits."""

    @property
    def fits(self) -> bool:
        return not self.problems


@dataclass(frozen=True)
class ClassTable:
    """The meaning of every id in a mask; a map class belongs to at most one channel."""

    name: str
    channels: tuple[Channel, ...]
    dynamic_ids: tuple[int, ...] = ()
    ignore_ids: tuple[int, ...] = ()
    ego_ids: tuple[int, ...] = ()
    id_names: Mapping[int, str] = field(default_factory=dict)
    """Name of every id that masks may hold; empty if unknown."""

    def __post_init__(self) -> None:
        _check_channels(self)

    def channel_of(self, label: ElementClass | int) -> int:
        """Index of the channel that may show a map class, -1 if the masks do not show it."""
        for index, channel in enumerate(self.channels):
            if label in channel.classes:
                return index
        return -1

    def channel_index(self, name: str) -> int:
        """Index of the channel called `name`.

        Raises:
            SemlocError: no channel has this name.
        """
        names = [channel.name for channel in self.channels]
        if name not in names:
            raise SemlocError(f"class table {self.name}: no channel '{name}'{_hint(name, names)}")
        return names.index(name)

    @property
    def channel_by_class(self) -> np.ndarray:
        """Channel index for every ElementClass value, -1 where there is none; int32[num_classes]."""
        return np.array([self.channel_of(label) for label in ElementClass], np.int32)

    @property
    def layer_numbers(self) -> np.ndarray:
        """For each mask id one more than its channel, 0 if it has none; uint8[256]."""
        numbers = np.zeros(256, np.uint8)
        for index, channel in enumerate(self.channels):
            numbers[list(channel.mask_ids)] = index + 1
        return numbers

    @property
    def unusable_ids(self) -> tuple[int, ...]:
        """Ids that hide the static world: ego body, dynamic objects, ignored pixels and 255."""
        return tuple(sorted({*self.dynamic_ids, *self.ignore_ids, *self.ego_ids, UNLABELED_ID}))

    def report(self, masks: np.ndarray | Iterable[np.ndarray]) -> TableReport:
        """How the table fits one mask or several: unknown ids, absent channels.

        Args:
            masks: class ids, uint8[h w], or an iterable of such masks.
        """
        stack = [masks] if isinstance(masks, np.ndarray) and masks.ndim == 2 else list(masks)
        counts = np.zeros(256, np.int64)
        for mask in stack:
            counts += np.bincount(np.asarray(mask).ravel(), minlength=256)
        return _fit(self, counts)


def load_class_table(name_or_path: str | Path) -> ClassTable:
    """The class table of a preset ('drive', 'cityscapes', ...) or of a YAML file.

    Args:
        name_or_path: a preset of `preset_names()` or the path of a YAML file of the same layout.

    Raises:
        SemlocError: no such preset or file, or the file does not follow the layout.

    >>> table = sj.load_class_table("mapillary")
    >>> [channel.name for channel in table.channels][:3]
    ['lane_marking', 'crosswalk', 'pole']
    """
    text = str(name_or_path)
    path = _PRESETS / f"{text}.yaml" if text in preset_names() else Path(text)
    if not path.is_file():
        raise SemlocError(
            f"class table '{text}': neither a preset nor a file{_hint(text, preset_names())}; "
            f"presets: {', '.join(preset_names())}"
        )
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        place = f" line {mark.line + 1}" if mark else ""
        raise SemlocError(f"class table {path}{place}: not a YAML file; check the file") from error
    with reading(f"class table {path}"):
        return parse_class_table(content, str(path))


def table_of(classes: Mapping, name: str = "classes") -> ClassTable:
    """The class table of {mask id: class or classes of the map}; other ids are background, 255 is ignored.

    Ids with the same classes are one channel.

    Raises:
        SemlocError: no ids, an id that is none, an unknown class, or a class that two different lists hold.
    """
    if not isinstance(classes, Mapping) or not classes:
        raise SemlocError(f"{name}: given {repr(classes)[:80]}; expected {{mask id: map class}}, e.g. {{1: 'pole'}}")
    by_classes: dict[tuple[ElementClass, ...], list[int]] = {}
    for number, labels in classes.items():
        if not _is_id(number) or number == UNLABELED_ID:
            raise SemlocError(f"{name}: mask id {number!r}; expected a whole number 0 ... 254")
        listed = labels if isinstance(labels, tuple | list | set | frozenset) else (labels,)
        known = {label if isinstance(label, ElementClass) else _element_class(label, name) for label in listed}
        key = tuple(sorted(known))
        by_classes.setdefault(key, []).append(number)
    channels = [
        Channel("+".join(label.name.lower() for label in key), tuple(ids), key) for key, ids in by_classes.items()
    ]
    return ClassTable(name, tuple(channels))


def part_of_table(whole: ClassTable, part: ClassTable) -> ClassTable:
    """A table, but for its channels that `part` lacks: what they show is background then.

    Raises:
        SemlocError: `part` has a channel that the whole table has not.
    """
    names = [channel.name for channel in part.channels]
    own = {channel.name for channel in whole.channels}
    if not own.issuperset(names):
        raise SemlocError(f"class table {part.name}: channels {names}; expected some of {sorted(own)}")
    return replace(whole, name=part.name, channels=tuple(c for c in whole.channels if c.name in names))


def preset_names() -> tuple[str, ...]:
    """Names of the class tables that come with the package."""
    return tuple(sorted(path.stem for path in _PRESETS.glob("*.yaml")))


def parse_class_table(content: object, where: str = "class table") -> ClassTable:
    """A class table from the content of its YAML file.

    Args:
        content: mapping with `name`, `ids` (name: id), `channels` (name, masks, classes) and, as needed, `dynamic`,
            `ego`, `ignore` (lists of names or ids).
        where: what to call the source in messages.

    Raises:
        SemlocError: a key, name or class is unknown, or a class or id is used twice.
    """
    keys = ("name", "ids", "channels", "dynamic", "ego", "ignore")
    _check_keys(content, keys, ("ids", "channels"), where)
    ids = content["ids"]
    if not isinstance(ids, dict) or not all(_is_id(value) for value in ids.values()):
        raise SemlocError(f"{where}: 'ids' must map names to numbers 0...255, got {ids!r}")
    channels = []
    if not isinstance(content["channels"], list):
        raise SemlocError(f"{where}: 'channels' must be a list of {{name, masks, classes}}")
    for index, entry in enumerate(content["channels"]):
        place = f"{where}: channel {index}"
        _check_keys(entry, ("name", "masks", "classes"), ("name", "masks", "classes"), place)
        labels = tuple(_element_class(label, place) for label in entry["classes"])
        channels.append(Channel(str(entry["name"]), _ids(entry["masks"], ids, place), labels))
    lists = {key: _ids(content.get(key) or [], ids, f"{where}: {key}") for key in ("dynamic", "ignore", "ego")}
    return ClassTable(
        name=str(content.get("name", where)),
        channels=tuple(channels),
        dynamic_ids=lists["dynamic"],
        ignore_ids=lists["ignore"],
        ego_ids=lists["ego"],
        id_names={number: str(name) for name, number in ids.items()},
    )


def _fit(table: ClassTable, counts: np.ndarray) -> TableReport:
    total = max(int(counts.sum()), 1)
    known = {*table.id_names, UNLABELED_ID}
    present = np.flatnonzero(counts)
    unknown = tuple(int(i) for i in present if table.id_names and i not in known)
    share = {channel.name: float(counts[list(channel.mask_ids)].sum()) / total for channel in table.channels}
    problems = []
    if unknown:
        percent = 100.0 * counts[list(unknown)].sum() / total
        listed = ", ".join(map(str, unknown[:8])) + (", ..." if len(unknown) > 8 else "")
        problems.append(
            f"the masks hold ids that class table {table.name} does not know: {listed} "
            f"({percent:.1f} % of the pixels); choose another table ({', '.join(preset_names())}) or write your own"
        )
    if not any(share.values()):
        listed = ", ".join(map(str, present[:12]))
        problems.append(
            f"none of the channels of class table {table.name} occurs in the masks (ids there: {listed}); "
            "choose the table that the masks were made with"
        )
    for name, part in share.items():
        if part > _MAX_SHARE:
            problems.append(
                f"channel '{name}' of class table {table.name} covers {100.0 * part:.0f} % of the masks; "
                "landmarks are small, so the ids probably mean something else: choose another table"
            )
    return TableReport(share, tuple(problems))


def _check_channels(table: ClassTable) -> None:
    where = f"class table {table.name}"
    seen_ids: dict[int, str] = {}
    seen_classes: dict[ElementClass, str] = {}
    if not table.channels:
        raise SemlocError(f"{where}: has no channels; give at least one {{name, masks, classes}}")
    for channel in table.channels:
        if not channel.mask_ids or not channel.classes:
            raise SemlocError(f"{where}: channel '{channel.name}' needs at least one mask id and one class")
        for seen, items in ((seen_ids, channel.mask_ids), (seen_classes, channel.classes)):
            for item in items:
                other = seen.setdefault(item, channel.name)
                if other != channel.name:
                    what = f"map class {item.name.lower()}" if isinstance(item, ElementClass) else f"mask id {item}"
                    raise SemlocError(
                        f"{where}: {what} is in the channels '{other}' and '{channel.name}'; keep it in one of them"
                    )
    hidden = sorted(seen_ids.keys() & set(table.unusable_ids))
    if hidden:
        raise SemlocError(f"{where}: mask ids {hidden} are in a channel and also dynamic, ego or ignored; choose one")


def _check_keys(content: object, allowed: tuple[str, ...], needed: tuple[str, ...], where: str) -> None:
    if not isinstance(content, dict):
        raise SemlocError(f"{where}: expected a mapping with the keys {', '.join(needed)}, got {repr(content)[:80]}")
    for key in content:
        if key not in allowed:
            raise SemlocError(f"{where}: unknown key '{key}'{_hint(str(key), allowed)}; keys: {', '.join(allowed)}")
    missing = [key for key in needed if key not in content]
    if missing:
        raise SemlocError(f"{where}: key '{missing[0]}' is missing; needed: {', '.join(needed)}")


def _ids(items: object, ids: Mapping[str, int], where: str) -> tuple[int, ...]:
    if not isinstance(items, list):
        raise SemlocError(f"{where}: expected a list of mask names or ids, got {repr(items)[:80]}")
    numbers = []
    for item in items:
        if not _is_id(item) and item not in ids:
            raise SemlocError(f"{where}: '{item}' is not among the 'ids'{_hint(str(item), list(ids))}")
        numbers.append(item if _is_id(item) else ids[item])
    return tuple(numbers)


def _element_class(label: object, where: str) -> ElementClass:
    name = str(label).upper()
    if name not in ElementClass.__members__:
        choices = [member.lower() for member in ElementClass.__members__]
        hint = _hint(str(label).lower(), choices)
        raise SemlocError(f"{where}: unknown map class '{label}'{hint}; classes: {', '.join(choices)}")
    return ElementClass[name]


def _is_id(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= 255


def _hint(word: str, choices: Iterable[str]) -> str:
    close = difflib.get_close_matches(word, list(choices), n=1)
    return f"; did you mean '{close[0]}'?" if close else ""

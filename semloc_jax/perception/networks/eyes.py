"""The network that tells a localizer what it needs: distances to borders, their sigmas, masks (room: perception; JAX
and host).

In: an image. Out: BorderMask. The network sees the image at a width of 641 to 1280 px, whatever the camera, so that
lines are about as wide in all of them, and speaks of cells of two of its pixels.
"""

import dataclasses
import hashlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from semloc_jax.errors import SemlocError
from semloc_jax.perception.border_mask import BorderMask, SeenBorders
from semloc_jax.perception.class_table import ClassTable, parse_class_table
from semloc_jax.perception.network import NetworkPreset, NetworkSegmenter
from semloc_jax.perception.networks.dense_net import STRIDE, DenseNet, DenseNetConfig, filled_up
from semloc_jax.perception.networks.levelling import levelled
from semloc_jax.perception.networks.weights import load_weights, read_card, save_weights
from semloc_jax.storage import reading

KIND = "eyes"
SHIPPED = Path(__file__).with_name("street.weights")
"""What `semloc learn eyes --simulated` wrote; its card says how, its figures and its limits."""
SHIPPED_GARAGE = Path(__file__).with_name("garage.weights")
"""The same, taught further on as many garages seen by fisheyes as streets; not for roads."""
REACH_PX = 40.0
"""Distances are clipped here [px of the network's image]: the coarsest ramp of the localizer."""
_DETAIL = 2
CELL_PX = STRIDE / _DETAIL
"""Pixels of the network's image in one cell of what it says."""
_MOST_WIDTH_PX = 1280
_AROUND_PX = 97
"""Side of the square whose light and colours are taken as usual: a few times the widest paint."""
_UNIT_PX = 8.0
"""One unit of the raw distance."""
_LOG_SIGMA = (np.log(0.2), np.log(60.0))


class Said(NamedTuple):
    """What a network says of the cells of a picture; k classes."""

    signed_px: Float[Array, "*b h w k"]
    log_sigma: Float[Array, "*b h w k"]
    logit: Float[Array, "*b h w k"]
    """Of being inside, were that as likely as not: it leads the features in learning, and nothing else uses it."""


def read_out(raw: Float[Array, "*b h w n"]) -> Said:
    """The meaning of what comes out of the network: three numbers for each class. Untrained: rather far, unsure.

    The distance is not clipped here: beyond a clip nothing would be learned any more.
    """
    distance, log_sigma, logit = jnp.split(raw, 3, axis=-1)
    return Said(_UNIT_PX * distance + 0.5 * REACH_PX, _bounded(log_sigma + jnp.log(_UNIT_PX)), logit)


@jax.custom_vjp
def _bounded(log_sigma: Float[Array, "*s"]) -> Float[Array, "*s"]:
    """The logarithm within its bounds. What is beyond one keeps the slope that leads back: else a class that was once
    told with the least sigma everywhere would never be told again; any other slope would lead farther out for ever."""
    return jnp.clip(log_sigma, *_LOG_SIGMA)


def _bounded_forward(log_sigma: Array) -> tuple[Array, Array]:
    return _bounded(log_sigma), log_sigma


def _bounded_back(log_sigma: Array, slope: Array) -> tuple[Array]:
    least, most = _LOG_SIGMA
    leads_out = ((log_sigma < least) & (slope > 0.0)) | ((log_sigma > most) & (slope < 0.0))
    return (jnp.where(leads_out, 0.0, slope),)


_bounded.defvjp(_bounded_forward, _bounded_back)


def network_config(num_classes: int, num_more: int = 0) -> DenseNetConfig:
    """The make of a network for so many classes.

    Args:
        num_classes: Classes that it tells.
        num_more: Scores of another network that it sees beside the colours: then a small one is enough.
    """
    size = {} if num_more == 0 else {"num_channels": (24, 32), "num_blocks": (1, 1)}
    return DenseNetConfig(3 * num_classes, _DETAIL, 3 + num_more, **size)


def working_scale(width_px: int) -> float:
    """Pixels of the network's image for one of an image of this width: a power of two."""
    return 2.0 ** np.floor(np.log2(_MOST_WIDTH_PX / width_px))


def working_image(image: np.ndarray) -> Float[np.ndarray, "h w 3"]:
    """The image at the scale of the network: red green blue, 0 ... 1, not filled up.

    Args:
        image: uint8[h w 3], blue green red.
    """
    height, width = image.shape[:2]
    scale = working_scale(width)
    if scale != 1.0:
        how = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR
        image = cv2.resize(image, (round(width * scale), round(height * scale)), interpolation=how)
    return np.ascontiguousarray(image[..., ::-1]).astype(np.float32) / np.float32(255.0)


def ready(picture: Float[np.ndarray, "h w c"]) -> Float[np.ndarray, "h w c"]:
    """A picture as the network takes it: colours by what is around them; scores of another network as they are."""
    colours = levelled(np.ascontiguousarray(picture[..., :3], np.float32), _AROUND_PX)
    return np.concatenate([colours, picture[..., 3:]], axis=-1) if picture.shape[-1] > 3 else colours


@dataclass(frozen=True)
class Eyes:
    """A network with the classes that it tells.

    Attributes:
        network: the network.
        table: what its class ids mean: channel k is id k + 1, what hides the map is the next.
        card: what it was taught on, and how well it does.
        helper: another network whose scores it sees beside the colours; None for none.
    """

    network: DenseNet
    table: ClassTable
    card: dict[str, Any] = field(default_factory=dict)
    helper: NetworkSegmenter | None = None

    @classmethod
    def new(cls, table: ClassTable, seed: int, helper: NetworkSegmenter | None = None) -> "Eyes":
        """Eyes that have not learned anything."""
        config = _config(table, helper)
        return cls(DenseNet.create(jax.random.key(seed), config), table, {}, helper)

    @property
    def config(self) -> DenseNetConfig:
        """Make of the network."""
        return _config(self.table, self.helper)

    def picture(self, image: np.ndarray) -> Float[np.ndarray, "h w c"]:
        """Colours and scores of an image uint8[h w 3] (blue green red), 0 ... 1; neither levelled nor filled up."""
        colours = working_image(image)
        if self.helper is None:
            return colours
        return np.concatenate([colours, self.helper.scores(image, colours.shape[1::-1])], axis=-1)

    def said(self, picture: Float[np.ndarray, "h w c"]) -> Said:
        """What they say of the cells of what `picture` gives."""
        return jax.tree.map(np.asarray, _said(self.network, jnp.asarray(ready(picture)), self.config.step_px))

    def __call__(self, image: np.ndarray) -> BorderMask:
        """The mask of an image uint8[h w 3] (blue green red), with its borders."""
        height, width = image.shape[:2]
        scale = working_scale(width)
        said = self.said(self.picture(image))
        planes = [np.moveaxis(plane, -1, 0) for plane in said]
        names = tuple(channel.name for channel in self.table.channels)
        stride = CELL_PX / scale
        signed_px, sigma_px = np.clip(planes[0], -REACH_PX, REACH_PX) / scale, np.exp(planes[1]) / scale
        known = len(names)  # what hides the map is told last and has no borders that anybody looks for
        borders = SeenBorders(signed_px[:known], sigma_px[:known], stride, names, REACH_PX / scale)
        inside = np.stack([borders.at(plane, (width, height), 1.0) for plane in signed_px])
        nearest = inside.argmin(axis=0)
        ids = np.where(np.take_along_axis(inside, nearest[None], 0)[0] < 0.0, nearest + 1, 0)
        return BorderMask.of(ids.astype(np.uint8), borders)

    def save(self, path: Path) -> None:
        """Write the weights with their card."""
        helper = None if self.helper is None else _plain_helper(self.helper)
        save_weights(
            path, self.network, self.card | {"kind": KIND, "table": _plain_table(self.table), "helper": helper}
        )

    @classmethod
    def load(cls, path: str | Path) -> "Eyes":
        """The eyes of a file.

        Raises:
            SemlocError: no such file, or not that of eyes; the network that helps them is missing or another one.
        """
        card = read_card(path)
        if card.get("kind") != KIND:
            raise SemlocError(f"weights {path}: of kind {card.get('kind')!r}; expected what `semloc learn eyes` wrote")
        where = f"weights {path}: class table"
        with reading(where):
            table = parse_class_table(card.pop("table", None), where)
        helper = _loaded_helper(card.pop("helper", None), Path(path))
        like = DenseNet.create(jax.random.key(0), _config(table, helper))
        return cls(load_weights(path, like), table, card, helper)


@eqx.filter_jit
def _said(network: DenseNet, picture: Float[Array, "h w c"], step_px: int) -> Said:
    """What a network says of a picture of any size, cells beyond it left out."""
    height, width, _ = picture.shape
    rows, columns = -(-height // int(CELL_PX)), -(-width // int(CELL_PX))
    return read_out(network(filled_up(picture, step_px))[:rows, :columns])


def num_told(table: ClassTable) -> int:
    """Classes that eyes with this table tell: its channels, and last what hides the map where the table names it."""
    return len(table.channels) + bool(table.dynamic_ids)


def _config(table: ClassTable, helper: NetworkSegmenter | None) -> DenseNetConfig:
    """The make of eyes for a table, which see the scores of a helper."""
    if helper is None:
        return network_config(num_told(table))
    return network_config(num_told(table), helper.scores(np.zeros((64, 64, 3), np.uint8), (8, 8)).shape[-1])


def _plain_helper(helper: NetworkSegmenter) -> dict[str, Any]:
    """A helper as a card holds it; which file it is, is known by its content."""
    return dataclasses.asdict(helper.preset) | {"sha256": _digest(Path(helper.preset.model))}


def _loaded_helper(stated: dict[str, Any] | None, path: Path) -> NetworkSegmenter | None:
    """The helper that a card states: its file where it was, or beside the weights.

    Raises:
        SemlocError: neither is that network.
    """
    if stated is None:
        return None
    with reading(f"weights {path}: helper"):
        digest, model = stated.pop("sha256"), Path(stated["model"])
        names = {entry.name for entry in dataclasses.fields(NetworkPreset)}
        values = {key: tuple(v) if isinstance(v, list) else v for key, v in stated.items() if key in names}
    for place in (model, path.parent / model.name):
        if place.is_file() and _digest(place) == digest:
            return NetworkSegmenter(NetworkPreset(**values | {"model": str(place)}))
    raise SemlocError(
        f"weights {path}: see the scores of network {model.name}, which is neither at {model} nor beside the weights, "
        "or is another one; put it there"
    )


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def eyes_table(table: ClassTable, classes: frozenset) -> ClassTable:
    """The class table of eyes that tell the channels of a table which show any of some map classes; ids from 1.

    Raises:
        SemlocError: none of them does.
    """
    kept = [channel for channel in table.channels if classes & set(channel.classes)]
    if not kept:
        raise SemlocError(f"eyes: class table {table.name} shows none of the classes of the map")
    channels = tuple(dataclasses.replace(channel, mask_ids=(number,)) for number, channel in enumerate(kept, start=1))
    return ClassTable(KIND, channels, id_names={0: "background"} | {c.mask_ids[0]: c.name for c in channels})


def _plain_table(table: ClassTable) -> dict[str, Any]:
    """A table as `parse_class_table` reads it."""
    channels = [
        {"name": c.name, "masks": list(c.mask_ids), "classes": [label.name.lower() for label in c.classes]}
        for c in table.channels
    ]
    ids = {name: number for number, name in table.id_names.items()}
    return {"name": table.name, "ids": ids, "channels": channels, "dynamic": list(table.dynamic_ids)}

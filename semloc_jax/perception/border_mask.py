"""A mask that knows more than class ids: how far every pixel is from the border of each class, and how sure (room:
perception; host).

In: class ids, distances of a network. Out: BorderMask, an array of class ids for whoever asks for no more.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np

SURE_PX = 2.0
"""Standard deviation of a border that counts as in any mask, a larger one counts less [px]: what solvers assume."""
LEAST_SHARE = 0.3
"""A border never counts less than this: a wrong place must not look right because everything is unsure. Ours."""
NEAR_SHARE = 0.9
"""Of the reach: only distances within it are those to a border, and a sigma is of them."""


@dataclass(frozen=True)
class SeenBorders:
    """What a network says of the borders of some classes.

    Attributes:
        signed_px: float32[k h w], distance to the border in pixels of the image, negative inside.
        sigma_px: float32[k h w], one standard deviation of it.
        stride: pixels of the image in one cell; cell (i, j) is centred on pixel (j + 0.5) stride - 0.5.
        names: channel of the class table of each of the k.
        reach_px: distances are clipped here: farther is all one.
    """

    signed_px: np.ndarray
    sigma_px: np.ndarray
    stride: float
    names: tuple[str, ...]
    reach_px: float

    def counted_px(self, name: str) -> np.ndarray | None:
        """Distances of a class [h w] as a solver with borders of one standard deviation `SURE_PX` should take them:
        those that are less sure are nearer by the ratio, so that over that deviation they are over their own. None
        where the network does not know the class."""
        if name not in self.names:
            return None
        k = self.names.index(name)
        share = np.clip(SURE_PX / np.maximum(self.sigma_px[k], 1e-3), LEAST_SHARE, 1.0)
        counted = self.signed_px[k] * share
        # Far away stays far away: only what is near a border has a distance that a sigma is of.
        return np.where(np.abs(self.signed_px[k]) < NEAR_SHARE * self.reach_px, counted, self.signed_px[k])

    def without(self, name: str) -> "SeenBorders":
        """The same but for one class, of which the class ids tell."""
        kept = [k for k, own in enumerate(self.names) if own != name]
        names = tuple(self.names[k] for k in kept)
        return replace(self, signed_px=self.signed_px[kept], sigma_px=self.sigma_px[kept], names=names)

    def at(self, field: np.ndarray, size_px: tuple[int, int], stride: float | int) -> np.ndarray:
        """A field of cells [h w] at another stride of the image, float32[height width], bilinear, not shifted.

        Args:
            field: values at this stride.
            size_px: (width, height) of what comes out, in its own cells.
            stride: pixels of the image in one of its cells.
        """
        ratio = stride / self.stride
        shift = 0.5 * ratio - 0.5
        to_field = np.array([[ratio, 0.0, shift], [0.0, ratio, shift]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        plane = np.ascontiguousarray(field, np.float32)
        return cv2.warpAffine(plane, to_field, size_px, flags=flags, borderMode=cv2.BORDER_REPLICATE)


class BorderMask(np.ndarray):
    """Class ids uint8[h w] with what is known of their borders; what is computed from it has class ids alone."""

    borders: SeenBorders | None = None

    @classmethod
    def of(cls, ids: np.ndarray, borders: SeenBorders) -> "BorderMask":
        """The mask of an image."""
        mask = np.ascontiguousarray(ids, np.uint8).view(cls)
        mask.borders = borders
        return mask

    def with_ids(self, ids: np.ndarray) -> "BorderMask":
        """Other class ids, the same borders: where something was hidden."""
        return BorderMask.of(ids, self.borders)


def borders_of(mask: np.ndarray) -> SeenBorders | None:
    """What a network said of the borders of a mask; None where it is class ids alone."""
    return mask.borders if isinstance(mask, BorderMask) else None

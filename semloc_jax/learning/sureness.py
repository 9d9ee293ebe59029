"""How sure cells are of what they hold: the loss of it, and where a lesson begins (room: learning; JAX)."""

import equinox as eqx
import jax
from jaxtyping import Array, Float

from semloc_jax.perception.networks.dense_net import DenseNet

UNSEEN_SEED = 1_000_003
"""Seeds of pictures that judge begin here: no lesson draws so many."""
_PRIOR_LOGIT = -4.0
"""What a cell is begun with: few have anything."""


def begun(network: DenseNet, num_classes: int) -> DenseNet:
    """The network, whose cells say at first that there is hardly ever anything; its first outputs are the classes."""
    return eqx.tree_at(lambda n: n.head.bias, network, network.head.bias.at[:num_classes].set(_PRIOR_LOGIT))


def focal_loss(logit: Float[Array, "*n"], heat: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Focal loss of each cell (Law and Deng 2018).

    Args:
        logit: of the cell.
        heat: 1 where something is, less around it.
    """
    has, sure = (heat == 1.0).astype(logit.dtype), jax.nn.sigmoid(logit)
    yes = has * (1.0 - sure) ** 2 * jax.nn.softplus(-logit)
    no = (1.0 - has) * (1.0 - heat) ** 4 * sure**2 * jax.nn.softplus(logit)
    return yes + no

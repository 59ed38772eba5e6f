"""How many liars a sparse fusion survives (Theorem 4 and its analogue for any sum of group norms).

The error stays bounded whatever p sensors inject if and only if, for every set I of p sensors and every u !=
0,

    sum over i in I of |G_i u|  <  sum over the other i of |G_i u|,

|.| being the penalty of sensor i: sum over its groups j of gamma_j ||g_j||_2, f_i = S_i g_i. The stable modes
have a prior and cannot move without bound, so u runs over the flat modes only.

References:
    Liu, Mo, Garone 2020 (docs/bibliography.md: liu2020), Theorem 4.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from securestate.estimators._sparse_design import Coordinates
from securestate.resilience.fusion_margin import Penalties

if TYPE_CHECKING:
    from securestate.estimators.sparse_fusion import Decomposition

Float = NDArray[np.float64]


def penalties(parts: Decomposition, axes: Coordinates, gammas: Float) -> Penalties:
    """The penalty of G_i u for every sensor, as blocks ||H_b u||."""
    G = parts.G.reshape(parts.G.shape[0] * parts.G.shape[1], parts.split.flat)
    blocks, owner = [], []
    for i, S_inverse in enumerate(axes.S_inverse):
        g = S_inverse @ G[axes.locals_[i] : axes.locals_[i + 1]]
        first, last = axes.sensors[i], axes.sensors[i + 1]
        for j in np.flatnonzero((axes.groups[:-1] >= first) & (axes.groups[:-1] < last)):
            blocks.append(gammas[j] * g[axes.groups[j] - first : axes.groups[j + 1] - first])
            owner.append(i)
    V_u = parts.split.V[:, : parts.split.flat]
    return Penalties(tuple(blocks), tuple(owner), V_u)

"""Do sensors vouch for a sensor, or do inputs that a controller may have computed from that sensor?"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from securestate.identification.forms import Innovations, Record
from securestate.identification.lags import past_length
from securestate.identification.order import score
from securestate.identification.redundancy import explained, left_out
from securestate.identification.subspace import Subspace

Indices = NDArray[np.int64]
Rows = Mapping[str, Indices]

#: A sensor can be checked if the others surely explain this share of its variation.
VERIFIABLE = 0.5

#: Orders of the model without inputs, and columns of its regressions, at most.
ORDERS, REGRESSORS = 20, 800


def lost_without_inputs(fitted: Record, kept: Record, rows: Rows, longest: int, edge: float) -> list[str]:
    """Which of these sensors the others do not vouch for in a model without inputs.

    A controller's output repeats what a sensor said, and where the plant is slow that tells the next reading,
    feedthrough or not.

    Args:
        fitted, kept: segments without gaps, of which the inputs are not used.
        rows: channels by sensor. longest: past that the regressions try. edge: largest |eigenvalue|.
    """
    fitted, kept = ([(y, u[:, :0]) for y, u in record] for record in (fitted, kept))
    m = kept[0][0].shape[1]
    past = max(2, min(2 * past_length(fitted, longest, False), REGRESSORS // m))
    subspace = Subspace(fitted, past, False, edge)
    orders = range(1, min(ORDERS, subspace.largest_order) + 1)
    form = max((subspace.model(n) for n in orders), key=lambda model: float(score(model, kept).mean()))
    return [name for name, own in rows.items() if not _share(form, own, kept)[1] >= VERIFIABLE]


def gained_at_once(subspace: Subspace, n: int, fitted: Record, kept: Record, rows: Rows) -> list[str]:
    """Sensors that only inputs of the same sample vouch for, each with both shares."""
    through = subspace.model(n)
    without = Subspace(fitted, subspace.p, False, subspace.edge).model(n)
    found = []
    for name, own in rows.items():
        at_once, later = _share(through, own, kept)[0], _share(without, own, kept)[0]
        if at_once >= VERIFIABLE > later:
            found.append(f"{name} ({100 * at_once:.0f} %, else {100 * max(later, 0):.0f} %)")
    return found


def _share(form: Innovations, own: Indices, kept: Record) -> tuple[float, float]:
    return explained(left_out(form, own, kept), [y[:, own] for y, _ in kept])

"""The least weight as a smallest hitting set: the sensors that see u meet every basis of rows.

    min w'z  subject to  sum of z over the sensors of B >= 1 for every basis B,   z in {0, 1}

Bases are added when the answer avoids one: if the sensors outside of z still span the space, a basis of
theirs is such a one; if they do not, z is the support of a u that they cannot see. (HiGHS solves every
round.)
"""

from __future__ import annotations

import time

import numpy as np
import scipy  # loads `optimize` where it is first used: few commands need it
from scipy import sparse

from securestate.resilience._bases import PIVOT, basis_along
from securestate.resilience._exact_count import Best
from securestate.resilience.eigenspaces import Array, Indices, Sight, kernel_of

#: Bases that are added in every round.
BATCH = 6


def hitting_set(
    sight: Sight, weights: Array, bases: list[Indices], best: Best, lower: float, deadline: float
) -> float:
    """Close the gap between a lower bound and the best support, or narrow it until time runs out.

    Returns:
        The lower bound; `best` becomes lighter.
    """
    used = np.unique(sight.owner)
    place = np.full(sight.sensors, -1)
    place[used] = np.arange(len(used))
    rng = np.random.default_rng(1)
    known = list(bases)
    while lower < best.weight and time.monotonic() < deadline:
        bound, chosen = _round([place[b] for b in known], weights[used], deadline)
        lower = max(lower, min(best.weight, bound))
        if chosen is None:
            break
        picked = used[chosen]
        new = _missed(sight, weights, picked, best, rng)
        if not new:  # the chosen sensors are all that see the direction offered, or rounding decides
            return float(best.weight) if best.weight <= weights[picked].sum() + 1e-9 else lower
        known += new
    return lower


def _round(bases: list[Indices], weights: Array, deadline: float) -> tuple[float, Indices | None]:
    """Lower bound of the smallest hitting set of these bases, and the set itself if it was found."""
    rows = np.repeat(np.arange(len(bases)), [len(b) for b in bases])
    meets = sparse.csr_matrix((np.ones(len(rows)), (rows, np.concatenate(bases))), (len(bases), len(weights)))
    answer = scipy.optimize.milp(
        weights,
        constraints=scipy.optimize.LinearConstraint(meets, 1, np.inf),
        integrality=np.ones(len(weights), dtype=np.int64),
        bounds=scipy.optimize.Bounds(0, 1),
        options={"time_limit": max(0.05, deadline - time.monotonic()), "mip_rel_gap": 0.0},
    )
    bound = answer.mip_dual_bound
    return (
        -np.inf if bound is None else float(bound) - 1e-6,
        np.flatnonzero(answer.x > 0.5) if answer.status == 0 else None,
    )


def _missed(
    sight: Sight, weights: Array, chosen: Indices, best: Best, rng: np.random.Generator
) -> list[Indices]:
    """Bases without any chosen sensor; none if the chosen ones are all that see some u, which is offered."""
    avoided = np.isin(sight.owner, chosen)
    new: list[Indices] = []
    for _ in range(BATCH):
        basis = basis_along(sight, np.argsort(10.0 * avoided + rng.random(len(avoided))))
        if basis is not None and not np.isin(basis.sensors, chosen).any():
            if basis.sharp:
                new.append(basis.sensors)
            continue
        hidden = kernel_of(sight.rows[~avoided], PIVOT)
        if hidden.shape[1]:
            best.offer(sight, weights, hidden[:, 0])
            return new
        break
    return new

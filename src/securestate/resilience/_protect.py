"""The smallest set of sensors that see every relevant mode between them.

If nobody can tamper with them, the others may lie as they like. In every eigenspace the rows of the set must
have full rank. For one eigenspace and sensors with one row each this is a basis, and any is as small.
Otherwise: an integer programme with Wolsey's inequalities, added until its answer has full rank everywhere,

    sum over i not in S of (rank(S + i) - rank(S)) x_i >= g - rank(S)   for every set S.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
import scipy  # loads `optimize` where it is first used: few commands need it

from securestate.resilience._bases import PIVOT, basis_along
from securestate.resilience.eigenspaces import Array, Indices, Sight, kernel_of


@final
@dataclass(frozen=True, eq=False)
class Cover:
    """A set of sensors that see every mode.

    Attributes:
        sensors: the set.
        lower: no smaller number can do; the set is smallest if it has as many.
    """

    sensors: Indices
    lower: int


def smallest_cover(sights: Sequence[Sight], time_limit: float = 30.0) -> Cover | None:
    """Find the smallest set that sees all of every eigenspace; None if not even all sensors do.

    Args:
        sights: what the sensors see of each eigenspace, at least one.
        time_limit: seconds after which the best set so far is returned.
    """
    deadline = time.monotonic() + time_limit
    every = np.arange(sights[0].sensors)
    if any(_rank_left(sight, every)[0] for sight in sights):
        return None
    several = any(np.bincount(sight.owner).max() > 1 for sight in sights)
    if len(sights) == 1 and not several:
        basis = basis_along(sights[0], np.arange(len(sights[0].rows)))
        if basis is not None:
            return Cover(basis.sensors, len(basis.sensors))
    chosen = _greedy(sights)
    at_least = 1 if several else max(sight.dimension for sight in sights)
    return Cover(chosen, at_least) if len(chosen) == at_least else _prove(sights, chosen, at_least, deadline)


def _rank_left(sight: Sight, chosen: Indices) -> tuple[int, Array]:
    """Return g - rank of the chosen sensors, and by how much every sensor would raise the rank, (N,)."""
    unseen = kernel_of(sight.rows[np.isin(sight.owner, chosen)], PIVOT)
    gain = np.zeros(sight.sensors)
    if unseen.shape[1]:
        rows = sight.rows @ unseen
        counts = np.bincount(sight.owner, minlength=sight.sensors)
        np.maximum.at(gain, sight.owner, (np.linalg.norm(rows, axis=1) > PIVOT).astype(float))
        for sensor in np.flatnonzero((counts > 1) & (gain > 0)):
            gain[sensor] = np.linalg.matrix_rank(rows[sight.owner == sensor], tol=PIVOT)
    return unseen.shape[1], gain


def _greedy(sights: Sequence[Sight]) -> Indices:
    """Add whoever raises most ranks, then drop whoever is not needed."""
    chosen: list[int] = []
    while True:
        left = [_rank_left(sight, np.array(chosen, dtype=np.intp)) for sight in sights]
        gains = np.sum([gain for _, gain in left], axis=0)
        if not sum(missing for missing, _ in left) or not gains.any():  # full rank, or all but by rounding
            break
        chosen.append(int(np.argmax(gains)))
    for sensor in list(chosen):
        rest = np.array([i for i in chosen if i != sensor], dtype=np.intp)
        if not any(_rank_left(sight, rest)[0] for sight in sights):
            chosen.remove(sensor)
    return np.sort(np.array(chosen, dtype=np.intp))


def _prove(sights: Sequence[Sight], known: Indices, lower: int, deadline: float) -> Cover:
    """Solve programmes with more and more inequalities until their answer sees everything."""
    rows, sides = _inequalities(sights, known[:0])
    sensors = sights[0].sensors
    while time.monotonic() < deadline:
        answer = scipy.optimize.milp(
            np.ones(sensors),
            constraints=scipy.optimize.LinearConstraint(np.array(rows), np.array(sides), np.inf),
            integrality=np.ones(sensors, dtype=np.int64),
            bounds=scipy.optimize.Bounds(0, 1),
            options={"time_limit": max(0.1, deadline - time.monotonic())},
        )
        if answer.mip_dual_bound is not None:
            lower = max(lower, int(np.ceil(answer.mip_dual_bound - 1e-6)))
        if answer.status != 0 or lower >= len(known):
            break
        chosen = np.flatnonzero(answer.x > 0.5)
        new_rows, new_sides = _inequalities(sights, chosen)
        if not new_rows:
            return Cover(chosen, len(chosen))
        more_rows, more_sides = _inequalities(sights, _widened(sights, chosen))
        rows += new_rows + more_rows
        sides += new_sides + more_sides
    return Cover(known, lower)


def _inequalities(sights: Sequence[Sight], chosen: Indices) -> tuple[list[Array], list[float]]:
    """One inequality per eigenspace of which the chosen sensors do not see all."""
    left = [_rank_left(sight, chosen) for sight in sights]
    return [gain for missing, gain in left if missing], [float(missing) for missing, _ in left if missing]


def _widened(sights: Sequence[Sight], chosen: Indices) -> Indices:
    """A larger set that still does not see everything: its inequality is sharper."""
    current = chosen
    for sensor in np.setdiff1d(np.arange(sights[0].sensors), chosen):
        larger = np.append(current, sensor)
        if any(_rank_left(sight, larger)[0] for sight in sights):
            current = larger
    return current

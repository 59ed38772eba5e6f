"""The fewest changes that lift every count to a goal: sensors added, or sensors protected.

    min sum of x   subject to   sum over i in S of (w_i + gain_i x_i) >= goal   for every support S,   x whole

w_i is 1 for a sensor that is there and 0 for one that is not; a copy gains 1, protection gains the goal.
Supports
are added as they are found: the lightest with the weights of the last answer, and all other light ones on the
    way.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
import scipy  # loads `optimize` where it is first used: few commands need it

from securestate.resilience._count import least_weight
from securestate.resilience.eigenspaces import Array, Indices, Sight


@final
@dataclass(frozen=True, eq=False)
class Change:
    """How often each candidate is taken.

    Attributes:
        times: (N,), whole numbers.
        lower: no fewer changes can do.
    """

    times: Indices
    lower: int


def fewest_changes(
    sights: Sequence[Sight], weights: Array, gain: Array, most: Array, goal: int, time_limit: float = 60.0
) -> Change | None:
    """Find the fewest changes that lift the least weight of every eigenspace to `goal`.

    Args:
        sights: what sensors and candidates see of each eigenspace.
        weights: w, (N,), 1 or 0.
        gain: of one change, (N,).
        most: how often each change can be made, (N,).
        goal: least weight asked for.
        time_limit: seconds.
    Returns:
        None if no changes are enough, or time ran out before a set was proved to be.
    """
    deadline = time.monotonic() + time_limit
    supports: dict[tuple[int, ...], Array] = {}
    times = np.zeros(len(weights), dtype=np.intp)
    lower = 0.0
    while time.monotonic() < deadline:
        proved, new = _light(sights, weights + gain * times, goal, deadline, supports)
        if not new:
            return Change(times, math.ceil(max(lower, 0.0) - 1e-6)) if proved else None
        answer = _smallest(list(supports.values()), weights, gain, most, goal, deadline)
        if answer is None:
            return None
        times, lower = answer
    return None


def _light(
    sights: Sequence[Sight],
    weights: Array,
    goal: int,
    deadline: float,
    known: dict[tuple[int, ...], Array],
) -> tuple[bool, bool]:
    """Add supports lighter than the goal that are met; tell if there is surely none, and if one is new."""
    proved, before = True, len(known)
    for sight in sights:
        limit = max(0.1, (deadline - time.monotonic()) / 4)
        found = least_weight(sight, weights, time_limit=limit, target=goal, collect=True)
        proved = proved and found.lower >= goal
        if found.upper >= goal:
            continue
        for u in (found.direction, *found.codewords):
            support = sight.support(u)
            if weights[support].sum() < goal:
                row = np.zeros(len(weights))
                row[support] = 1.0
                known[tuple(support.tolist())] = row
    return proved, len(known) > before


def _smallest(
    supports: list[Array], weights: Array, gain: Array, most: Array, goal: int, deadline: float
) -> tuple[Indices, float] | None:
    rows = np.array(supports)
    answer = scipy.optimize.milp(
        np.ones(len(weights)),
        constraints=scipy.optimize.LinearConstraint(rows * gain, goal - rows @ weights, np.inf),
        integrality=np.ones(len(weights), dtype=np.int64),
        bounds=scipy.optimize.Bounds(0, most),
        options={"time_limit": max(0.1, deadline - time.monotonic())},
    )
    found: Array | None = answer.x  # None: impossible, or no answer in time
    bound = answer.mip_dual_bound
    return (
        None
        if found is None
        else (np.round(found).astype(np.intp), -np.inf if bound is None else float(bound))
    )

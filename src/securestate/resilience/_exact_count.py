"""Minimum weights that need no bounds: one direction, a plane, and branch and bound for small eigenspaces.

All functions answer: over all u != 0, what is the least weight of the sensors that see V u, and who are they?
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np

from securestate.resilience.eigenspaces import Array, Field, Indices, Sight, kernel_of


@dataclass
class Best:
    """The lightest support found so far.

    Attributes:
        weight: its weight; every support that is not lighter is of no interest.
        sensors: who sees it; None as long as none lighter than the first `weight` was found.
        direction: u, (g,), unit length.
        complete: whether nothing lighter exists; False if time ran out.
        certain: no direction that was looked at weighs less, whatever tolerance decides the doubtful cases.
    """

    weight: float
    sensors: Indices | None = None
    direction: Field | None = None
    complete: bool = True
    certain: float = math.inf

    def offer(self, seen: Sight, weights: Array, u: Field) -> None:
        """Take u if its support is lighter."""
        sensors = seen.support(u)
        weight = float(weights[sensors].sum())
        if weight < self.weight:
            self.weight, self.sensors, self.direction = weight, sensors, u / np.linalg.norm(u)


def doubtful(blind: float) -> float:
    """Share below which it is doubtful whether a sensor sees a direction that was computed."""
    return max(10 * blind, 1e-7)


def search_plane(seen: Sight, weights: Array) -> tuple[Field, float]:
    """The direction of a plane that the least weight sees, and what no direction is lighter than (exact).

    A sensor is blind to no direction, to one, or to all. The heaviest group of sensors that are blind to the
    same direction decides; if no sensor has a blind direction, any direction is as good.
    """
    counts = np.bincount(seen.owner, minlength=seen.sensors)
    total = float(weights[counts > 0].sum())
    single = counts[seen.owner] == 1
    rows, own = seen.rows[single], weights[seen.owner[single]]
    if not len(rows):
        return np.array([1.0, 0.0], dtype=seen.rows.dtype), total
    blind = np.stack([-rows[:, 1], rows[:, 0]], axis=1)  # row u = 0, without a conjugate
    missed = np.abs(rows @ blind.T)  # (row, direction); rows and directions have length one
    lost = own @ (missed <= seen.blind)
    lost_at_most = own @ (missed <= doubtful(seen.blind))
    u: Field = blind[int(np.argmax(lost))]
    return u, total - float(lost_at_most.max())


def branch_and_bound(seen: Sight, weights: Array, best: Best, deadline: float) -> None:
    """Search all u for one that less weight than `best` sees (exact unless time runs out).

    Branches on the first sensor, heaviest first, that does not see u: it is either blind, which leaves a
    smaller space, or its weight counts. At most C(best + g, g) nodes with unit weights: for small g or small
    counts.
    """
    order = np.argsort(-weights, kind="stable")
    active = order[np.isin(order, seen.owner)]
    _branch(seen, np.eye(seen.dimension, dtype=seen.rows.dtype), active, 0.0, weights, best, deadline)


def _branch(
    seen: Sight, basis: Field, active: Indices, counted: float, weights: Array, best: Best, deadline: float
) -> None:
    """Search the span of `basis`; `counted` is the weight of the sensors that are known to see."""
    if time.monotonic() > deadline:
        best.complete = False
        return
    inside = restricted(seen, basis)
    if basis.shape[1] <= 2:
        u, least = np.ones(1, dtype=basis.dtype), float(weights[np.unique(inside.owner)].sum())
        if basis.shape[1] == 2:
            u, least = search_plane(inside, weights)
        best.offer(seen, weights, basis @ u)
        best.certain = min(best.certain, least)
        return
    best.offer(seen, weights, basis @ _generic(basis.shape[1]))
    seeing = active[np.isin(active, inside.owner)]
    for k, sensor in enumerate(seeing):
        if counted >= best.weight or not best.complete:
            return
        smaller = kernel_of(inside.rows[inside.owner == sensor], seen.blind)
        if smaller.shape[1]:
            _branch(seen, basis @ smaller, seeing[k + 1 :], counted, weights, best, deadline)
        counted += weights[sensor]


def restricted(seen: Sight, basis: Field) -> Sight:
    """What sensors see of the span of orthonormal columns, rows orthonormal per sensor again."""
    rows = seen.rows @ basis
    alone = np.bincount(seen.owner, minlength=seen.sensors)[seen.owner] == 1
    lengths = np.linalg.norm(rows, axis=1)
    kept = alone & (lengths > seen.blind)
    parts, owners = [rows[kept] / lengths[kept][:, None]], [seen.owner[kept]]
    for sensor in np.unique(seen.owner[~alone]):
        _, shares, Wh = np.linalg.svd(rows[seen.owner == sensor], full_matrices=False)
        mine = Wh[: len(shares)][shares > seen.blind]
        parts.append(mine)
        owners.append(np.full(len(mine), sensor))
    owner = np.concatenate(owners)
    order = np.argsort(owner, kind="stable")
    return Sight(np.vstack(parts)[order], owner[order].astype(np.intp), seen.sensors, seen.blind)


def _generic(g: int) -> Array:
    """A direction without any pattern, the same every time."""
    u: Array = np.random.default_rng(g).standard_normal(g)
    return u

"""Bases of an eigenspace made of rows of sensors, and every direction that few sensors of a basis see.

Bound (Brouwer and Zimmermann's for linear codes, over the real or complex numbers): the rows B of a basis see
every u != 0. If all u seen by fewer than f sensors of each of T bases are known, any other u is seen f T
times in all, and if no sensor stands in more than L bases per unit of its weight, u weighs at least f T / L.
    f = 1: nothing has to be known.
    f = 2: u seen by one row of B alone is a column of B^-1, seen by one sensor with several rows a span of
    columns.
    f = 3: u seen by two rows of B is a combination of two columns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from securestate.resilience._exact_count import Best, branch_and_bound, doubtful, restricted
from securestate.resilience.eigenspaces import Array, Field, Indices, Sight

#: Smallest pivot of a row of length one that makes it independent of those before.
PIVOT = 1e-7
#: Largest ||B^-1|| of a basis that a bound may rest on.
STEEPEST = 1e6
#: A bound rests on B only if ||B^-1|| sqrt(g) times the share that counts as blind is no larger: then every u
#: is seen.
CLEAR = 0.1


@dataclass(frozen=True, eq=False)
class Basis:
    """g rows of sensors that are independent.

    Attributes:
        sensors: whose rows they are, without repetition.
        owner: (g,), the sensor of every row of B.
        codewords: (g, g), column k is the u that row k of B alone sees.
        seen: (R, g), what all rows see of the codewords.
        sharp: whether B is far enough from singular for a bound to rest on it.
    """

    sensors: Indices
    owner: Indices
    codewords: Field
    seen: Field
    sharp: bool

    def supports(self, sight: Sight, blind: float | None = None) -> NDArray[np.bool_]:
        """(N, g): which sensors see which codeword; `blind` instead of the sight's own."""
        share = sight.blind if blind is None else blind
        sees = np.abs(self.seen) > share * np.linalg.norm(self.codewords, axis=0)
        supports = np.zeros((sight.sensors, sees.shape[1]), dtype=bool)
        np.logical_or.at(supports, sight.owner, sees)
        return supports


def basis_along(sight: Sight, order: Indices) -> Basis | None:
    """Make a basis of the first independent rows in an order (Gauss-Jordan); None if they do not span."""
    g = sight.dimension
    reduced = np.vstack([sight.rows, np.eye(g, dtype=sight.rows.dtype)])
    free = np.ones(g, dtype=bool)
    chosen: list[int] = []
    columns: list[int] = []
    for row in order:
        sizes = np.where(free, np.abs(reduced[row]), 0.0)
        column = int(np.argmax(sizes))
        if sizes[column] <= PIVOT:
            continue
        _eliminate(reduced, int(row), column)
        free[column] = False
        chosen.append(int(row))
        columns.append(column)
        if len(chosen) == g:
            owner = sight.owner[chosen]
            seen, codewords = reduced[: len(sight.rows), columns], reduced[len(sight.rows) :, columns]
            steep = float(np.linalg.norm(codewords))
            sharp = steep <= STEEPEST and steep * np.sqrt(g) * sight.blind <= CLEAR
            return Basis(np.unique(owner), owner, codewords, seen, sharp)
    return None


def _eliminate(reduced: Field, row: int, column: int) -> None:
    """Make `row` a unit vector by column operations."""
    reduced[:, column] /= reduced[row, column]
    rest = reduced[row].copy()
    rest[column] = 0
    others = np.flatnonzero(np.abs(rest) > 1e-14)
    touched = np.flatnonzero(np.abs(reduced[:, column]) > 1e-14)
    if len(others):
        reduced[np.ix_(touched, others)] -= np.outer(reduced[touched, column], rest[others])
    reduced[row] = 0
    reduced[row, column] = 1


def seen_by_one(sight: Sight, weights: Array, basis: Basis, best: Best, deadline: float) -> bool:
    """Offer all u that one sensor of the basis sees; False if time ran out before all were searched."""
    supports = basis.supports(sight)
    lightest = int(np.argmin(weights @ supports))
    best.offer(sight, weights, basis.codewords[:, lightest])
    certain = weights @ basis.supports(sight, doubtful(sight.blind))
    best.certain = min(best.certain, float(certain.min()))
    counts = np.bincount(basis.owner, minlength=sight.sensors)
    for sensor in np.flatnonzero(counts > 1):
        span = np.linalg.qr(basis.codewords[:, basis.owner == sensor])[0]
        inside = Best(best.weight)
        branch_and_bound(restricted(sight, span), weights, inside, deadline)
        best.certain = min(best.certain, inside.certain)
        if inside.direction is not None:
            best.offer(sight, weights, span @ inside.direction)
        if not inside.complete:
            return False
    return True


def seen_by_two(sight: Sight, weights: Array, basis: Basis, best: Best) -> None:
    """Offer all u that two rows of the basis see; for sensors with one row each.

    b - q a, for codewords a and b, hides from every sensor that sees both in the ratio q. Only pairs whose
    supports differ in less weight than the best can win.
    """
    sees = basis.supports(sight)[sight.owner]
    own = weights[sight.owner]
    alone = own @ sees
    shared = (sees * own[:, None]).T @ sees.astype(float)
    differ = alone[:, None] + alone - 2 * shared
    for a, b in np.argwhere(np.triu(differ < best.weight, 1)):
        both = sees[:, a] & sees[:, b]
        if not both.any():
            continue
        ratio = basis.seen[both, b] / basis.seen[both, a]
        sizes = np.abs(ratio)
        same = np.abs(ratio[:, None] - ratio) <= doubtful(sight.blind) * np.maximum(sizes[:, None], sizes)
        hidden = same @ own[both]
        k = int(np.argmax(hidden))
        weight = float(alone[a] + alone[b] - shared[a, b] - hidden[k])
        best.certain = min(best.certain, weight)
        if weight < best.weight:
            best.offer(sight, weights, basis.codewords[:, b] - ratio[k] * basis.codewords[:, a])

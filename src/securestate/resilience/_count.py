"""How many sensors see the direction that fewest see: a minimum-distance problem over the real numbers.

    c = min over u != 0 of the weight of the sensors with X_i u != 0

One dimension is counted, a plane is searched, larger spaces get bounds from bases that close at once where
few sensors see a direction, as in grids. Where they do not, branch and bound (up to four dimensions) and a
hitting-set programme narrow them until time runs out: the answer is always a lower and an upper bound, and
the sensors and the direction of the upper one.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import final

import numpy as np

from securestate.resilience._bases import PIVOT, Basis, basis_along, seen_by_one, seen_by_two
from securestate.resilience._exact_count import Best, branch_and_bound, search_plane
from securestate.resilience._hitting_set import hitting_set
from securestate.resilience.eigenspaces import Array, Field, Indices, Sight, kernel_of

#: Most bases that are drawn.
BASES = 400
#: Bases that are searched for pairs.
PAIRED = 8
#: Largest dimension for branch and bound over the whole space.
SMALL = 4


@final
@dataclass(frozen=True, eq=False)
class Count:
    """Bounds of the least weight, and who attains the upper one.

    Attributes:
        lower, upper: bounds of the weight; equal if the count is exact.
        sensors: those that see `direction`, of weight `upper`.
        direction: u, (g,), unit length.
        method: what settled it: "rank", "counting", "plane", "bases", "pairs", "branch and bound", "hitting
            set".
        codewords: directions met on the way that are lighter than `target`.
    """

    lower: float
    upper: float
    sensors: Indices
    direction: Field
    method: str
    codewords: tuple[Field, ...] = ()

    @property
    def exact(self) -> bool:
        """Whether both bounds agree."""
        return self.lower >= self.upper


def least_weight(
    sight: Sight,
    weights: Array | None = None,
    *,
    time_limit: float = 60.0,
    target: float = math.inf,
    collect: bool = False,
) -> Count:
    """Bounds of the least weight of sensors that see a direction.

    Args:
        sight: what the sensors see of an eigenspace.
        weights: of every sensor, (N,), >= 0; default 1 each.
        time_limit: seconds after which the bounds are returned as they are.
        target: a lower bound that is enough.
        collect: return also all other directions lighter than `target`.
    """
    weights = np.ones(sight.sensors) if weights is None else weights
    counted = sight.only(weights > 0)
    g = sight.dimension
    hidden = kernel_of(counted.rows, PIVOT)
    if hidden.shape[1]:
        return Count(0, 0, np.zeros(0, dtype=np.intp), hidden[:, 0], "rank")
    best = Best(math.inf)
    if g <= 2:
        u, least = search_plane(counted, weights) if g == 2 else (np.ones(1), math.inf)
        best.offer(counted, weights, u)
        return _counted(least, best, "plane" if g == 2 else "counting")
    return _Search(counted, weights, target, time_limit, collect).run()


def _counted(lower: float, best: Best, method: str, codewords: tuple[Field, ...] = ()) -> Count:
    assert best.sensors is not None and best.direction is not None
    return Count(min(lower, best.weight), best.weight, best.sensors, best.direction, method, codewords)


class _Search:
    """Bounds from bases, pairs, branch and bound and hitting sets, in this order, until they meet."""

    def __init__(self, sight: Sight, weights: Array, target: float, time_limit: float, collect: bool) -> None:
        self.sight, self.weights, self.target = sight, weights, target
        self.start, self.time_limit = time.monotonic(), time_limit
        self.whole = bool(np.all(weights == np.round(weights)))
        self.several = bool(np.bincount(sight.owner, minlength=sight.sensors).max() > 1)
        self.best = Best(math.inf)
        self.bound = 0.0
        self.bases: list[Basis] = []
        self.pool: list[Field] | None = [] if collect else None

    def run(self) -> Count:
        method = "bases"
        self._draw_bases()
        if not self.bases:  # full rank by a hair only
            u = np.linalg.svd(self.sight.rows)[2][-1].conj()
            self.best.offer(self.sight, self.weights, u)
            return _counted(0.0, self.best, "rank")
        if not self._done and not self.several:
            method = "pairs"
            self._pairs()
        if not self._done and self.sight.dimension <= SMALL:
            method = "branch and bound"
            self._branch()
        sensors = [basis.sensors for basis in self.bases if basis.sharp]
        if not self._done and sensors:
            method = "hitting set"
            until = self._until(1.0)
            self._raise(hitting_set(self.sight, self.weights, sensors, self.best, self.lower, until))
        return _counted(self.lower, self.best, method, tuple(self.pool or ()))

    @property
    def lower(self) -> float:
        """What is certain: of the directions that were looked at, and of all others."""
        return min(self.best.weight, self.best.certain, self.bound)

    @property
    def _done(self) -> bool:
        return self.lower >= min(self.best.weight, self.target)

    def _until(self, share: float) -> float:
        return self.start + share * self.time_limit

    def _raise(self, bound: float) -> None:
        """Take a lower bound for directions that are not lighter than the best; whole weights are whole."""
        self.bound = max(self.bound, math.ceil(bound - 1e-9) if self.whole and bound < math.inf else bound)

    def _draw_bases(self) -> None:
        """Draw bases of the rows that have stood in fewest; offer what one sensor of a basis sees."""
        rng = np.random.default_rng(0)
        load, drawn, known, stale = np.zeros(self.sight.sensors), 0, 0, 0
        while drawn < BASES and stale < 3 * self.sight.dimension:
            basis = basis_along(self.sight, self._least_loaded(load, rng))
            if basis is None:
                return
            self.bases.append(basis)
            complete = seen_by_one(self.sight, self.weights, basis, self.best, self._until(0.6))
            self._collect(basis)
            if basis.sharp:
                load[basis.sensors] += 1
                drawn += 1
                known += 1 + complete
                before = self.bound
                self._raise(known / (load / self._per_weight).max())
                stale = 0 if self.bound > before else stale + 1
            else:
                stale += 1
            if self._done or time.monotonic() > self._until(0.4):
                return

    @property
    def _per_weight(self) -> Array:
        return np.where(self.weights > 0, self.weights, 1.0)

    def _least_loaded(self, load: Array, rng: np.random.Generator) -> Indices:
        """Order of the rows by load per weight, ties by chance, rows of one sensor together."""
        key = (load / self._per_weight)[self.sight.owner] + 1e-6 * rng.random(len(self.sight.owner))
        if self.several:
            key += 1e-3 * rng.permutation(self.sight.sensors)[self.sight.owner] / self.sight.sensors
        order: Indices = np.argsort(key, kind="stable")
        return order

    def _collect(self, basis: Basis) -> None:
        if self.pool is not None and math.isfinite(self.target):
            light = self.weights @ basis.supports(self.sight) < self.target
            lengths = np.linalg.norm(basis.codewords, axis=0)
            self.pool += [basis.codewords[:, k] / lengths[k] for k in np.flatnonzero(light)]

    def _pairs(self) -> None:
        """Search all directions that two rows of a basis see, basis by basis."""
        load = np.zeros(self.sight.sensors)
        sharp = [basis for basis in self.bases if basis.sharp][:PAIRED]
        for searched, basis in enumerate(sharp, 1):
            seen_by_two(self.sight, self.weights, basis, self.best)
            load[basis.sensors] += 1
            self._raise(3 * searched / (load / self._per_weight).max())
            if self._done or time.monotonic() > self._until(0.7):
                return

    def _branch(self) -> None:
        search = Best(self.best.weight)
        branch_and_bound(self.sight, self.weights, search, self._until(0.9))
        if search.direction is not None:
            self.best.offer(self.sight, self.weights, search.direction)
        if search.complete:
            self.best.certain = min(self.best.certain, search.certain)
            self.bound = math.inf

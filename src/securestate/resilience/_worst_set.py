"""The k sensors without which least is left of what all together see of an eigenspace.

    eta_k = min over |I| = k and v != 0 of ||X_rest v|| / ||X v|| = sqrt of the smallest eigenvalue of I -
    H_II,

H = X (X* X)^-1 X*, X = R^-1/2 C V. eta_k has no unit and is 0 if and only if some k sensors alone see a
direction.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from securestate.resilience.eigenspaces import Array, Field, Indices

#: Sets that are enumerated at most; more of them get bounds.
BUDGET = 600_000
#: Sets that are judged at once.
BATCH = 5_000
#: Smaller values are rounding.
ROUNDING = 1e-7


@final
@dataclass(frozen=True, eq=False)
class WorstSet:
    """Bounds of eta_k and the set that attains the upper one.

    Attributes:
        lower, upper: bounds in [0, 1].
        sensors: the set.
    """

    lower: float
    upper: float
    sensors: Indices


def worst_set(
    X: Field,
    channel_sensor: NDArray[np.int64],
    allowed: NDArray[np.bool_],
    k: int,
    time_limit: float = 60.0,
) -> WorstSet:
    """Bounds of eta_k over sets of k allowed sensors; exact where they can be enumerated.

    Args:
        X: (m, g), what the channels see of the eigenspace, in standard deviations.
        channel_sensor: the sensor of every channel.
        allowed: (N,), the sensors that may be in the set.
        k: size of the set; all that are allowed if they are fewer.
        time_limit: seconds after which the bounds are what they are.
    """
    deadline = time.monotonic() + time_limit
    candidates = np.flatnonzero(allowed)
    k = min(k, len(candidates))
    rows = _orthonormal(X, channel_sensor, len(allowed))
    if rows is None:
        return WorstSet(0.0, 0.0, candidates[:k])
    if k == 0:
        return WorstSet(1.0, 1.0, candidates[:0])
    told = _Told(rows[candidates])
    leverage = told.leverage
    if X.shape[1] == 1:
        chosen = np.sort(np.argsort(-leverage, kind="stable")[:k])
        share = float(told.left(chosen[None])[0])
        return WorstSet(share, share, candidates[chosen])
    best, chosen = _alternate(told, leverage, k, deadline)
    lower = 0.0
    if math.comb(told.sensors, k) <= BUDGET:
        best, chosen, complete = _enumerate(told, leverage, k, best, chosen, deadline)
        lower = best if complete else 0.0
    if lower < best:
        lower = max(lower, min(best, told.from_below(k)))
    return WorstSet(float(lower), float(best), candidates[chosen])


def _orthonormal(X: Field, channel_sensor: NDArray[np.int64], sensors: int) -> Field | None:
    """Q of X = Q R by sensor, (N, c, g), zeros where channels lack; None if X has not full rank."""
    lengths = np.linalg.norm(X, axis=0)
    Q, R = np.linalg.qr(X / np.where(lengths > 0, lengths, 1.0))
    if len(X) < X.shape[1] or not lengths.all() or np.abs(np.diag(R)).min() <= 1e-9:
        return None
    counts = np.bincount(channel_sensor, minlength=sensors)
    rows = np.zeros((sensors, counts.max(), X.shape[1]), dtype=Q.dtype)
    rows[channel_sensor, np.arange(len(X)) - np.concatenate([[0], np.cumsum(counts)])[channel_sensor]] = Q
    return rows


class _Told:
    """What sensors tell of directions in which all together tell 1.

    The smallest eigenvalue of I - H_II, H = Q Q*, is that of I - sum over I of Q_i* Q_i: whichever is smaller
    is taken.
    """

    def __init__(self, rows: Field) -> None:
        self.sensors, self.channels, self.directions = rows.shape
        self.gram = np.swapaxes(rows.conj(), 1, 2) @ rows
        flat = rows.reshape(-1, self.directions)
        shape = (self.sensors, self.channels, self.sensors, self.channels)
        self.hat = np.ascontiguousarray((flat @ flat.conj().T).reshape(shape).transpose(0, 2, 1, 3))
        self.leverage: Array = np.einsum("igg->i", self.gram).real

    def left(self, sets: Indices) -> Array:
        """Square root of that eigenvalue for sets (K, k)."""
        size = sets.shape[1] * self.channels
        if size >= self.directions:
            return self.left_of(np.add.reduce(self.gram[sets], axis=1))
        parts = self.hat[sets[:, :, None], sets[:, None, :]].transpose(0, 1, 3, 2, 4)
        return self.left_of(parts.reshape(len(sets), size, size))

    def left_of(self, taken: Field) -> Array:
        """The same from matrices with the eigenvalues of H_II."""
        left = 1.0 - np.linalg.eigvalsh(taken)[:, -1]
        return np.where(left > ROUNDING**2, np.sqrt(np.maximum(left, 0.0)), 0.0)

    def additions(self, found: list[int], others: Indices) -> Array:
        """What is left when one of the others is taken as well."""
        if (len(found) + 1) * self.channels >= self.directions:
            return self.left_of(self.gram[found].sum(axis=0) + self.gram[others])
        known = np.tile(np.array(found, dtype=np.intp), (len(others), 1))
        return self.left(np.hstack([known, others[:, None]]))

    def from_below(self, k: int) -> float:
        """No eigenvalue exceeds the k largest of single sensors, nor the bound of Gershgorin over blocks."""
        flat = self.channels == 1
        sizes = np.abs(self.hat[:, :, 0, 0]) if flat else np.linalg.norm(self.hat, 2, axis=(2, 3))
        own = np.diag(sizes)
        beside = np.sort(sizes - np.diag(own), axis=1)[:, ::-1][:, : k - 1].sum(axis=1)
        largest = min(np.sort(own)[::-1][:k].sum(), (own + beside).max())
        return float(np.sqrt(max(0.0, 1.0 - largest)))


def _alternate(told: _Told, leverage: Array, k: int, deadline: float) -> tuple[float, Indices]:
    """A good set, from some loud sensors as a start: add who takes most of what is left, then exchange."""
    best, chosen = np.inf, np.argsort(-leverage, kind="stable")[:k]
    for first in chosen[:8]:
        found, value = [int(first)], np.inf
        while len(found) < k:
            found.append(_best_addition(told, found)[0])
        for _ in range(20):
            addition, left = _best_addition(told, found[1:])
            found = [*found[1:], addition]
            if left >= value - 1e-14:
                break
            value = left
        current = np.sort(np.array(found, dtype=np.intp))
        left = float(told.left(current[None])[0])
        if left < best:
            best, chosen = left, current
        if time.monotonic() > deadline:
            break
    return float(best), np.sort(chosen)


def _best_addition(told: _Told, found: list[int]) -> tuple[int, float]:
    others = np.setdiff1d(np.arange(told.sensors), found)
    left = told.additions(found, others)
    pick = int(np.argmin(left))
    return int(others[pick]), float(left[pick])


def _enumerate(
    told: _Told, leverage: Array, k: int, best: float, chosen: Indices, deadline: float
) -> tuple[float, Indices, bool]:
    """Judge every set whose leverages add up to enough: the largest eigenvalue is at most the trace.

    Returns:
        The least share, its set, and whether every set was judged.
    """
    for sets in _batches(told.sensors, k):
        promising = sets[leverage[sets].sum(axis=1) >= 1 - best**2 - 1e-12]
        if len(promising):
            left = told.left(promising)
            pick = int(np.argmin(left))
            if left[pick] < best:
                best, chosen = float(left[pick]), promising[pick]
        if time.monotonic() > deadline:
            return best, chosen, False
    return best, chosen, True


def _batches(sensors: int, k: int) -> Iterator[Indices]:
    sets = itertools.combinations(range(sensors), k)
    while batch := list(itertools.islice(sets, BATCH)):
        yield np.array(batch, dtype=np.intp)

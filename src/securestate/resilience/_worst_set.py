"""The k sensors without which least is left of what all together see of an eigenspace.

    eta_k = min over |I| = k and v != 0 of ||X_rest v|| / ||X v|| = sqrt of the smallest eigenvalue of I -
    H_II,

H = X (X* X)^-1 X*, X = R^-1/2 C V. eta_k has no unit and is 0 if and only if some k sensors alone see a
direction.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from securestate.resilience.eigenspaces import Array, Field, Indices

#: Sets that are enumerated at most; more of them get bounds.
BUDGET = 600_000
#: Sets that are judged at once.
BATCH = 20_000
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


def worst_set(X: Field, channel_sensor: NDArray[np.int64], allowed: NDArray[np.bool_], k: int) -> WorstSet:
    """Bounds of eta_k over sets of k allowed sensors; exact where they can be enumerated.

    Args:
        X: (m, g), what the channels see of the eigenspace, in standard deviations.
        channel_sensor: the sensor of every channel.
        allowed: (N,), the sensors that may be in the set.
        k: size of the set; all that are allowed if they are fewer.
    """
    candidates = np.flatnonzero(allowed)
    k = min(k, len(candidates))
    H = _hat_blocks(X, channel_sensor, len(allowed))
    if H is None:
        return WorstSet(0.0, 0.0, candidates[:k])
    H = H[np.ix_(candidates, candidates)]
    own = H[np.arange(len(H)), np.arange(len(H))]
    leverage = np.einsum("icc->i", own).real
    if k == 0:
        return WorstSet(1.0, 1.0, candidates[:0])
    if X.shape[1] == 1:
        chosen = np.sort(np.argsort(-leverage, kind="stable")[:k])
        share = float(_left(H, chosen[None])[0])
        return WorstSet(share, share, candidates[chosen])
    best, chosen = _alternate(H, leverage, k)
    if math.comb(len(H), k) <= BUDGET:
        best, chosen = _enumerate(H, leverage, k, best, chosen)
        lower = best
    else:
        lower = min(best, _from_below(H, k))
    return WorstSet(float(lower), float(best), candidates[chosen])


def _hat_blocks(X: Field, channel_sensor: NDArray[np.int64], sensors: int) -> Field | None:
    """H in blocks, (N, N, c, c), zeros where a sensor has fewer channels; None if X has not full rank."""
    lengths = np.linalg.norm(X, axis=0)
    Q, R = np.linalg.qr(X / np.where(lengths > 0, lengths, 1.0))
    sizes = np.abs(np.diag(R))
    if len(X) < X.shape[1] or not lengths.all() or sizes.min() <= 1e-9:
        return None
    counts = np.bincount(channel_sensor, minlength=sensors)
    rows = np.zeros((sensors, counts.max(), X.shape[1]), dtype=Q.dtype)
    place = np.arange(len(X)) - np.concatenate([[0], np.cumsum(counts)])[channel_sensor]
    rows[channel_sensor, place] = Q
    flat = rows.reshape(-1, X.shape[1])
    blocks = (flat @ flat.conj().T).reshape(sensors, counts.max(), sensors, counts.max())
    return np.ascontiguousarray(blocks.transpose(0, 2, 1, 3))


def _left(H: Field, sets: Indices) -> Array:
    """Return sqrt of the smallest eigenvalue of I - H_II for sets (K, k)."""
    k, c = sets.shape[1], H.shape[2]
    parts = H[sets[:, :, None], sets[:, None, :]].transpose(0, 1, 3, 2, 4).reshape(len(sets), k * c, k * c)
    left = 1.0 - np.linalg.eigvalsh(parts)[:, -1]
    return np.where(left > ROUNDING**2, np.sqrt(np.maximum(left, 0.0)), 0.0)


def _alternate(H: Field, leverage: Array, k: int) -> tuple[float, Indices]:
    """A good set, from every sensor as a start: add whoever takes most of what is left, then exchange."""
    best, chosen = np.inf, np.arange(k)
    starts = max(1, min(8, 1000 // k**2))
    for first in np.argsort(-leverage, kind="stable")[:starts]:
        found = [int(first)]
        while len(found) < k:
            found.append(_best_addition(H, found)[0])
        value = np.inf
        for _ in range(20):
            found = found[1:]
            addition, left = _best_addition(H, found)
            found.append(addition)
            if left >= value - 1e-14:
                break
            value = left
        current = np.sort(np.array(found, dtype=np.intp))
        left = float(_left(H, current[None])[0])
        if left < best:
            best, chosen = left, current
    return float(best), chosen


def _best_addition(H: Field, found: list[int]) -> tuple[int, float]:
    others = np.setdiff1d(np.arange(len(H)), found)
    sets = np.hstack([np.tile(np.array(found, dtype=np.intp), (len(others), 1)), others[:, None]])
    left = _left(H, sets)
    pick = int(np.argmin(left))
    return int(others[pick]), float(left[pick])


def _enumerate(H: Field, leverage: Array, k: int, best: float, chosen: Indices) -> tuple[float, Indices]:
    """Judge every set whose leverages add up to enough: the largest eigenvalue is at most the trace."""
    for sets in _batches(len(H), k):
        promising = sets[leverage[sets].sum(axis=1) >= 1 - best**2 - 1e-12]
        if len(promising):
            left = _left(H, promising)
            pick = int(np.argmin(left))
            if left[pick] < best:
                best, chosen = float(left[pick]), promising[pick]
    return best, chosen


def _batches(sensors: int, k: int) -> Iterator[Indices]:
    sets = itertools.combinations(range(sensors), k)
    while batch := list(itertools.islice(sets, BATCH)):
        yield np.array(batch, dtype=np.intp)


def _from_below(H: Field, k: int) -> float:
    """Gershgorin's bound: no eigenvalue exceeds a diagonal block plus the k - 1 largest blocks beside it."""
    sizes = np.linalg.norm(H, 2, axis=(2, 3)) if H.shape[2] > 1 else np.abs(H[:, :, 0, 0])
    own = np.diag(sizes)
    beside = np.sort(sizes - np.diag(own), axis=1)[:, ::-1][:, : k - 1].sum(axis=1)
    return float(np.sqrt(max(0.0, 1.0 - (own + beside).max())))

"""What the other sensors say of a sensor: its redundancy, which decides whether its lie can be found at all.

Sensor i is left out of the innovations form, whose noises stay correlated (Q, S) = (K S K', K S), and
predicted from all others up to the same sample:

    G = (A P C' + K S) (C P C' + S)^-1   of the others,   y_i | others ~ C_i x + cov(y_i, e) S_e^-1 e

The noise that y_i shares with the others counts, too. Never take A - K C in place of A here: it would feed
the sensor's own reading back as a known input.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, special

from securestate._steady_state import doubling
from securestate.identification.forms import Innovations, Predictor, Record, Stack, symmetric

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


def left_out(model: Innovations, sensor: Indices, record: Record) -> list[Array]:
    """What is left of a sensor's channels once all others are known, per segment, each (N, c).

    Args:
        model: the law of all channels. sensor: the channels left out, (c,). record: segments without gaps.
    Raises:
        LinAlgError: the others have no stationary filter.
    """
    others = np.setdiff1d(np.arange(len(model.C)), sensor)
    if not len(others):
        return _by_inputs(model, sensor, record)
    reduced, P = _reduced(model, others)
    predict = Predictor(reduced)
    shared = model.C[sensor] @ P @ reduced.C.T + model.S[np.ix_(sensor, others)]
    onto = linalg.cho_solve(linalg.cho_factor(reduced.S), shared.T).T
    stack = Stack([(y[:, others], u) for y, u in record])
    e, x = predict(stack)
    expected = x @ model.C[sensor].T + stack.u @ model.D[sensor].T + e @ onto.T
    return [y[:, sensor] - part for (y, _), part in zip(record, stack.parts(expected), strict=True)]


def _reduced(model: Innovations, others: Indices) -> tuple[Innovations, Array]:
    """The innovations form of some channels alone, and P = cov x[k|k-1] of its filter."""
    A, C, D = model.A, model.C[others], model.D[others]
    Q, S = symmetric(model.K @ model.S @ model.K.T), model.S[np.ix_(others, others)]
    cross = (model.K @ model.S)[:, others]
    # The filter with correlated noises is that of A - cross S^-1 C and Q - cross S^-1 cross'.
    onto = linalg.cho_solve(linalg.cho_factor(S), cross.T).T
    P = doubling(A - onto @ C, C, symmetric(Q - onto @ cross.T) + 1e-10 * np.eye(len(A)), S)
    if P is None:
        raise np.linalg.LinAlgError("no stationary filter of the others")
    innovation = symmetric(C @ P @ C.T + S)
    gain = linalg.cho_solve(linalg.cho_factor(innovation), (A @ P @ C.T + cross).T).T
    return Innovations(A, model.B, C, D, gain, innovation), P


def _by_inputs(model: Innovations, sensor: Indices, record: Record) -> list[Array]:
    """What the inputs alone leave of the only sensor."""
    silent = Innovations(model.A, model.B, model.C, model.D, np.zeros_like(model.K), model.S)
    stack = Stack(record)
    return [part[:, sensor] for part in stack.parts(Predictor(silent)(stack)[0])]


#: Blocks at most, and samples per block at least: within one, errors depend on each other.
BLOCKS, BLOCK = 12, 25

#: A variance, as a share of that of the history, below which a channel did not move.
STILL = 1e-9

#: Of the lower bound, one-sided.
CONFIDENCE = 0.95


def explained(remains: Sequence[Array], readings: Sequence[Array]) -> tuple[float, float]:
    """Share of a sensor's variation that the others explain, and what it is at least with 95 % confidence.

    Of several channels the one with the least counts; NaN if one was hardly read or did not move. The error
    of the ratio comes from blocks of samples.

    Args:
        remains, readings: (N, c) per segment, in the same units, NaN where nothing was read.
    """
    shares = []
    for i in range(remains[0].shape[1]):
        left = np.concatenate([part[:, i] for part in remains])
        said = np.concatenate([part[:, i] for part in readings])
        there = np.isfinite(left) & np.isfinite(said)
        shares.append(_explained(left[there], said[there]))
    unknown = [share for share in shares if np.isnan(share[0])]
    return unknown[0] if unknown else min(shares)


def _explained(left: Array, said: Array) -> tuple[float, float]:
    if len(left) < 2 * BLOCK:
        return float("nan"), float("nan")
    squares, variation = left**2, (said - said.mean()) ** 2
    whole = float(variation.mean())
    if whole < STILL:
        return float("nan"), float("nan")
    ratio = float(squares.mean()) / whole
    # Linearised: the error of a ratio of means is that of the mean of (squares - ratio * variation) / whole.
    spread = (squares - ratio * variation) / whole
    number = min(BLOCKS, len(spread) // BLOCK)
    length = len(spread) // number
    blocks = spread[: number * length].reshape(number, length).mean(axis=1)
    error = float(blocks.std(ddof=1)) / np.sqrt(number)
    return 1 - ratio, 1 - ratio - float(special.stdtrit(number - 1, CONFIDENCE)) * error

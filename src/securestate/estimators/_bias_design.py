"""Design of the bias monitor: its kernel, its limit from simulated innovations, its variance factor.

The limit. Whitened innovations of the model itself are white, so independent standard normal numbers go
through the kernel's own statistic. h(t) is the least ratio of the last `PERSIST` samples if one sensor that
can be named led all of them by more than `MARGIN`, minus infinity otherwise: at a limit l a sensor is named
where h > l. Times where h > l that are no more than a window apart are one episode. Above a level u that is
passed by `EPISODES` episodes the peaks exceed u by amounts that are exponential with mean beta (the tail of
a maximum of squares of normal numbers), so that

    limit = u + beta ln(episodes above u * run_length / samples)

The factor. On clean records the mean over blocks of `BLOCK` samples of the largest ratio of a leader that
can be named must be that of the model. It falls as gamma grows; gamma >= 1 is found by bisection.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from securestate import _kernels
from securestate._belief import Belief
from securestate._steady_state import SteadyState
from securestate.errors import DesignError, InputError
from securestate.estimators.base import check_inputs, check_measurements
from securestate.estimators.kalman import KalmanFilter
from securestate.plant import Plant

Float = NDArray[np.float64]
#: Whether a sensor that can be named leads, its ratio, and how far it is ahead.
Leads = tuple[NDArray[np.bool_], NDArray[np.int64], Float, Float]

#: Onsets that compete, and the weight of the penalty on young ones.
WINDOW, KAPPA = 40, 1.5
#: The winner must be ahead by this much, for so many samples in a row.
MARGIN, PERSIST = 4.0, 3
#: What the limit rises by for a further sensor, and the squared significance below which a bias is dropped.
FURTHER, DROP = 6.0, 9.0
#: Largest variance of the innovations, in those of the model, with which a name still means something.
GAMMA_LIMIT = 2.0
#: Samples per block in which the largest ratio is taken, and the fewest blocks that say what it is.
BLOCK, BLOCKS = 20, 10
#: Samples of a clean record from which its start is estimated.
START = 20
#: Simulated samples per `run_length`, and the range they are kept in; then as few as so many multiply-adds
#: allow, but never fewer than the last number.
REPEATS, RANGE, WORK, LEAST = 50, (50_000, 200_000), 2e9, 4000
#: Episodes whose peaks make the tail, and the steps in which its beginning is looked for.
EPISODES, STRIDE = 200, 0.25


def kernel(plant: Plant, steady: SteadyState, limit: float, gamma: float) -> _kernels.Kernel:
    """The bias monitor of `plant`; with an infinite limit it names nobody."""
    decision = (limit, MARGIN, PERSIST, FURTHER, DROP)
    statistic = (WINDOW, KAPPA, gamma)
    return _kernels.bias_monitor(plant, _filter(steady), statistic=statistic, decision=decision)


def ideal(plant: Plant, steady: SteadyState, samples: int) -> Leads:
    """Who leads at every sample of a run of the model itself; the same numbers at every call."""
    news = np.random.default_rng(0).standard_normal((samples + WINDOW, plant.m))
    leads = _kernels.bias_leads(plant, _filter(steady), statistic=(WINDOW, KAPPA, 1.0), news=news)
    leader, ratio, ahead = leads[0][WINDOW:], leads[1][WINDOW:], leads[2][WINDOW:]
    return ~plant.uncheckable[leader], leader, ratio, ahead


def simulated_samples(plant: Plant, run_length: float) -> int:
    """How many samples of the model are simulated for its limit."""
    affordable = WORK / (WINDOW * plant.m**2)
    return int(max(LEAST, min(np.clip(REPEATS * run_length, *RANGE), affordable)))


def limit_of(leads: Leads, run_length: float) -> float:
    """The limit at which an episode begins once in `run_length` samples on average.

    At least `DROP`: a bias named below it would be dropped at once.
    """
    h = heights(leads)
    expected = len(h) / run_length
    wanted = max(expected, min(EPISODES, len(h) / (5 * WINDOW)))
    level, tail = float(h.max()), peaks(h, np.inf)
    while len(tail) < wanted and level > 0:
        level -= STRIDE
        tail = peaks(h, level)
    if not len(tail):
        return DROP
    found = level + float(np.mean(tail - level)) * np.log(len(tail) / expected)
    return max(float(found), DROP)


def heights(leads: Leads) -> Float:
    """h(t): the limit below which a sensor would be named."""
    allowed, leader, ratio, ahead = leads
    level = np.where(allowed & (ahead > MARGIN), ratio, -np.inf)
    h = level.copy()
    for back in range(1, PERSIST):
        same = leader[back:] == leader[:-back]
        h[back:] = np.where(same, np.minimum(h[back:], level[:-back]), -np.inf)
    h[: PERSIST - 1] = -np.inf
    return h


def peaks(h: Float, level: float) -> Float:
    """The peak of every episode above a level."""
    above = np.flatnonzero(h > level)
    if not len(above):
        return np.empty(0)
    first = np.flatnonzero(np.diff(above, prepend=-2 * WINDOW) > WINDOW)
    return np.asarray(np.maximum.reduceat(h[above], first), dtype=np.float64)


def block_level(allowed: NDArray[np.bool_], ratio: Float) -> list[float]:
    """The largest ratio of a leader that can be named, in every whole block."""
    g = np.where(allowed, ratio, -2 * KAPPA * np.log(WINDOW))
    blocks = len(g) // BLOCK
    return [float(value) for value in g[: blocks * BLOCK].reshape(blocks, BLOCK).max(axis=1)]


def variance_factor(plant: Plant, steady: SteadyState, leads: Leads, records: object) -> float:
    """Gamma from clean records.

    Raises:
        InputError: the records do not fit the plant or are too short.
        DesignError: the innovations vary too much for this model.
    """
    target = float(np.mean(block_level(leads[0], leads[2])))
    started = [_started(plant, steady, y, u) for y, u in clean_records(plant, records)]
    samples = sum(len(y) // BLOCK for y, _, _ in started)
    if samples < BLOCKS:
        expected = f"at least {BLOCKS} blocks of {BLOCK} samples after the first {START + WINDOW} of each"
        raise InputError("calibrate_on", expected, f"{samples}")

    def excess(gamma: float) -> float:
        run = kernel(plant, steady, np.inf, gamma)
        levels = [level for part in started for level in _levels(plant, run, part)]
        return float(np.mean(levels)) - target

    if excess(1.0) <= 0:
        return 1.0
    if excess(GAMMA_LIMIT) > 0:
        raise DesignError(
            f"on the clean records the innovations vary more than {GAMMA_LIMIT:g} times as much as the model "
            "says: the model is inadequate, and a bias cannot be told from its errors",
            "identify the plant again (securestate.identify), and see what securestate.judge says of it",
        )
    low, high = 1.0, GAMMA_LIMIT
    while high - low > 0.005:
        middle = (low + high) / 2
        low, high = (middle, high) if excess(middle) > 0 else (low, middle)
    return high


def clean_records(plant: Plant, records: object) -> Iterator[tuple[Float, Float]]:
    """Pairs of measurements (T, m) and inputs (T, p) from what `calibrate_on` may be."""
    several: Sequence[object] = records if isinstance(records, list) else [records]
    for number, record in enumerate(several):
        paired = isinstance(record, tuple) and len(record) == 2
        if bool(plant.n_inputs) != paired:
            expected = "(y, u) pairs, because the plant has inputs" if plant.n_inputs else "arrays y (T, m)"
            raise InputError(f"calibrate_on[{number}]", expected, type(record).__name__)
        y, u = record if isinstance(record, tuple) else (record, None)
        try:
            yield _checked(plant, y, u)
        except InputError as wrong:
            name = f"calibrate_on[{number}]: {wrong.argument}"
            raise type(wrong)(name, wrong.expected, wrong.received) from None


def _checked(plant: Plant, y: ArrayLike, u: ArrayLike | None) -> tuple[Float, Float]:
    measured = check_measurements(y, plant, ("T",))
    return measured, check_inputs(u, plant, measured.shape)


def _started(plant: Plant, steady: SteadyState, y: Float, u: Float) -> tuple[Float, Float, Float]:
    """The record after its first samples, and x there as they tell it to who knows nothing."""
    start = min(START, len(y) - 1)
    wide = steady.P_prior + 1e6 * np.diag(np.diag(steady.P_prior))
    first = KalmanFilter(plant).run(
        y[:start], u[:start] if plant.n_inputs else None, Belief(np.zeros(plant.n), wide)
    )
    x = plant.successor(first.x[-1:], u[start - 1 : start])
    return np.ascontiguousarray(y[start:]), np.ascontiguousarray(u[start:]), np.ascontiguousarray(x)


def _levels(plant: Plant, monitor: _kernels.Kernel, part: tuple[Float, Float, Float]) -> list[float]:
    y, u, x = part
    told = _kernels.Filter(monitor, x, None).advance(y[np.newaxis], u, len(y), False)
    named = dict(zip(monitor.diagnostics, told["diagnostics"][0, WINDOW:].T, strict=True))
    return block_level(~plant.uncheckable[named["leader"].astype(np.int64)], named["ratio"])


def _filter(steady: SteadyState) -> tuple[Float, Float, Float]:
    parts = (steady.gain, steady.innovation_cov, steady.P_posterior)
    gain, innovation_cov, covariance = (np.ascontiguousarray(part) for part in parts)
    return gain, innovation_cov, covariance

"""What no estimator can beat: exact Bayesian estimates that know how the attack draws its sets and its lies.

For scalar sensors of one state and liars drawn afresh at every sample, the past says nothing of who lies now.
Given x, the readings are independent, so that the likelihood of x summed over all sets of liars is

    sum over sizes s of  p(s) / C(N, s)  sum over |Z| = s of  prod_{i not in Z} f_i(x)  prod_{i in Z} g_i(x)

f_i(x) the density of a reading that is honest and g_i(x) of one that is not. The inner sum is the elementary
symmetric polynomial of the pairs (f_i, g_i), so that all 2^N sets cost N products (`sets`). The density of
the state is a vector on a grid that follows it.

"density": its mean has the least mean squared error there is, because nothing is approximated but integrals.
"moments": the same step, but only mean and variance go on to the next sample, as in every filter.
"blind":   as "moments", but all that is known of a lie is that it is further off than honest readings are:
           Student's density with one degree of freedom about the prediction. No limit, but what summing over
           all sets is worth to one who does not know the attack. The other two do, down to the true bias, and
           a lie that is known is a measurement; so they may be below the oracle, which hears no liar.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import comb
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from benches._secure_cells import CELLS, Cell, Episode, episode
from securestate import KalmanFilter, Plant

Float = NDArray[np.float64]
Way = Literal["density", "moments", "blind"]
#: By the names they have in tables.
WAYS: Mapping[str, Way] = {"limit": "density", "limit, moments": "moments", "limit, blind": "blind"}

#: Points of the grid, and how many standard deviations it reaches to each side.
POINTS, REACH = 401, 7.0
#: How far a first grid reaches where nothing is known, and its points.
COLD_REACH, COLD_POINTS = 10.0, 2001
#: Nodes for the factor of attack (25), and where its density is tabled.
NODES, TABLE = 200, np.linspace(-60.0, 60.0, 2401)
#: Square of the scale of a lie of which nothing is known, in variances of the innovation.
SCALE = 9.0
#: Attacks whose density is known here.
KINDS = ("25pt", "26", "26c", "26f", "bias")


def has_limit(cell: Cell) -> bool:
    """Whether `limit` can say something of a cell."""
    return cell.plant == "scalar" and not cell.fixed and cell.kind.partition(":")[0] in KINDS


CELLS_WITH_LIMIT = tuple(filter(has_limit, CELLS))


@dataclass(frozen=True)
class Belief:
    """A density of the state: weights, of sum one, at equidistant points."""

    x: Float
    p: Float

    @property
    def mean(self) -> float:
        return float(self.p @ self.x)

    @property
    def variance(self) -> float:
        return float(self.p @ (self.x - self.mean) ** 2)


def sets(f: Float, g: Float, law: Float) -> Float:
    """Log likelihood of x summed over all sets of liars.

    Args:
        f, g: log densities of every reading, honest and not, (N, points).
        law: probability of every number of liars, from none to len(law) - 1.
    """
    N, top = len(f), len(law) - 1
    total = np.zeros((top + 1, f.shape[1]))
    total[0] = 1.0
    scale = np.maximum(f, g)
    for honest, lying in zip(np.exp(f - scale), np.exp(g - scale), strict=True):
        total[1:] = total[1:] * honest + total[:-1] * lying
        total[0] *= honest
    each = law / [comb(N, s) for s in range(top + 1)]
    with np.errstate(divide="ignore"):
        return np.asarray(scale.sum(axis=0) + np.log(each @ total))


def limit(cell: Cell, seed: int, way: Way) -> float:
    """Mean squared error over the attacked samples of one run."""
    drawn = episode(cell, seed)
    return float(np.mean(_Bayes(cell, drawn, way).errors()[drawn.scored :] ** 2))


class _Bayes:
    """One run of the exact filter."""

    def __init__(self, cell: Cell, drawn: Episode, way: Way) -> None:
        plant, truth = drawn.trajectory.plant, drawn.trajectory
        self.A, self.Q = float(plant.A[0, 0]), float(plant.Q[0, 0])
        self.C, self.R = plant.C[:, 0], np.diag(plant.R)
        self.plant, self.cold, self.scored = plant, drawn.cold, drawn.scored
        self.x, self.clean, self.y = truth.x[0, :, 0], truth.clean[0], truth.y[0].copy()
        self.lies, self.reacts = truth.attacked[0], bool(truth.reactions)
        low, high = cell.count
        self.law = np.bincount(np.arange(low, high + 1), minlength=high + 1) / (high - low + 1)
        self.carries_density = way == "density"
        self.lying = self._unknown if way == "blind" else self._density_of_lies(cell)

    def errors(self) -> Float:
        """Error of the mean at every sample."""
        errors, belief = np.empty(len(self.y)), None
        for k in range(len(self.y)):
            ahead = self._first(self.y[k]) if belief is None else self._predict(belief)
            if self.reacts:
                self.y[k] = np.where(self.lies[k], 2 * self.C * ahead.mean - self.clean[k], self.clean[k])
            belief = self._update(ahead, k)
            errors[k] = belief.mean - self.x[k]
        return errors

    def _first(self, y: Float) -> Belief:
        """The steady state of the Kalman filter; cold, any state near the middle of what the sensors say."""
        if self.cold:
            x = np.median(y / self.C) + np.linspace(-COLD_REACH, COLD_REACH, COLD_POINTS)
            return Belief(x, np.full(COLD_POINTS, 1 / COLD_POINTS))
        steady = KalmanFilter(self.plant).steady
        assert steady is not None
        return gaussian(0.0, float(steady.P_prior[0, 0]))

    def _predict(self, belief: Belief) -> Belief:
        mean, variance = self.A * belief.mean, self.A**2 * belief.variance + self.Q
        if not self.carries_density:
            return gaussian(mean, variance)
        x = mean + np.sqrt(variance) * np.linspace(-REACH, REACH, POINTS)
        likely = belief.p > 1e-14 * belief.p.max()
        steps = x[:, np.newaxis] - self.A * belief.x[likely]
        return _normal(x, np.exp(-0.5 * steps**2 / self.Q) @ belief.p[likely])

    def _update(self, ahead: Belief, k: int) -> Belief:
        """Bayes' rule, summed over who lies."""
        y, x = self.y[k], ahead.x
        honest = _log_normal(self._off(y, x), self.R)
        calm = k < self.scored
        told = honest.sum(axis=0) if calm else sets(honest, self.lying(k, ahead), self.law)
        return _normal(x, ahead.p * np.exp(told - told.max()))

    def _unknown(self, k: int, ahead: Belief) -> Float:
        """Student's density about the prediction, whatever x is."""
        S = self.C**2 * ahead.variance + self.R
        u = (self.y[k] - self.C * ahead.mean) ** 2 / (SCALE * S)
        density = -np.log(np.pi * np.sqrt(SCALE * S) * (1 + u))
        return np.broadcast_to(density[:, np.newaxis], (len(S), len(ahead.x)))

    def _density_of_lies(self, cell: Cell) -> Callable[[int, Belief], Float]:
        """Log density of every reading at sample k if it is a lie, (N, points), given the belief ahead."""
        name, _, size = cell.kind.partition(":")
        if name == "25pt":
            tables = np.log([_noise_linear(TABLE, R) for R in self.R])
            return lambda k, ahead: _looked_up(tables, self._off(self.y[k], ahead.x))
        if name == "bias":
            return lambda k, ahead: _log_normal(self._off(self.y[k] - float(size), ahead.x), self.R)
        if name == "26f":
            return lambda k, ahead: self._mirrored(k, ahead.x, self.C * ahead.mean)
        expected = local_predictions(self.plant, self.y if name == "26" else self.clean)
        return lambda k, ahead: self._mirrored(k, ahead.x, expected[k])

    def _mirrored(self, k: int, x: Float, about: Float) -> Float:
        return _log_normal(self._off(2 * about - self.y[k], x), self.R)

    def _off(self, y: Float, x: Float) -> Float:
        """How far readings are from what they should be, (N, points)."""
        return np.asarray(y[:, np.newaxis] - np.outer(self.C, x))


def local_predictions(plant: Plant, y: Float) -> Float:
    """What the steady-state filter of every sensor alone expects of its reading, (T, N).

    With what the sensors send these are numbers that a defender has. With clean readings, (26c), it has not:
    the limit is then that of one who is told them, and may be too low.
    """
    A, expected = float(plant.A[0, 0]), np.empty_like(y)
    for i, C in enumerate(plant.C[:, 0]):
        steady = KalmanFilter(plant.select([i])).steady
        assert steady is not None
        gain, z = float(steady.gain[0, 0]), 0.0
        for k, reading in enumerate(y[:, i]):
            expected[k, i] = C * z
            z = A * (z + gain * (reading - C * z))
    return expected


def gaussian(mean: float, variance: float) -> Belief:
    """A Gaussian on its grid."""
    unit = np.linspace(-REACH, REACH, POINTS)
    return _normal(mean + np.sqrt(variance) * unit, np.exp(-0.5 * unit**2))


def _normal(x: Float, p: Float) -> Belief:
    return Belief(x, p / p.sum())


def _log_normal(d: Float, variance: Float) -> Float:
    v = variance[:, np.newaxis]
    return np.asarray(-0.5 * (np.log(2 * np.pi * v) + d**2 / v))


def _looked_up(tables: Float, off: Float) -> Float:
    return np.stack([np.interp(d, TABLE, one) for d, one in zip(off, tables, strict=True)])


def _noise_linear(d: Float, R: float) -> Float:
    """Density of (1 + beta) v + theta: v ~ N(0, R), beta ~ U(-5, 5), theta ~ U(-10, 10)."""
    beta = -5 + 10 * (np.arange(NODES) + 0.5) / NODES
    wide = np.sqrt(R) * np.abs(1 + beta)[:, np.newaxis]
    return np.asarray(np.mean(ndtr((d + 10) / wide) - ndtr((d - 10) / wide), axis=0) / 20 + 1e-30)

"""The setting of Section VI: the plant, a simulation that stays bounded, and the normalised error."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from papers._report import Value
from papers._setting import BaseSetting
from securestate import Estimator, InsecureWarning, KalmanFilter, Run, SparseFusion, Status

Float = NDArray[np.float64]
FOLDER = Path(__file__).parent


@dataclass(frozen=True)
class Setting(BaseSetting):
    """Plant, configuration and record of one run of the program."""

    folder = FOLDER

    @cached_property
    def kalman(self) -> KalmanFilter:
        return KalmanFilter(self.plant)

    @cached_property
    def trace(self) -> float:
        """Return tr P, by which the paper divides every mean squared error."""
        return float(np.trace(self.paper(1.0).decomposition.steady.P_posterior))

    def paper(self, gamma: float) -> SparseFusion:
        """Return (31) as printed, which breaks its own Theorem 4 here and warns of it (theorem4.py)."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", InsecureWarning)
            return SparseFusion(self.plant, form="paper", gamma=gamma)

    @cached_property
    def record(self) -> Record:
        return simulate(self)

    def nmse(self, estimator: Estimator, y: Float) -> Value:
        """Return the mean squared error over tr P; its standard error comes from the independent runs."""
        return self.mean(self.square(self.run(estimator, y)) / self.trace)

    def square(self, run: Run) -> Float:
        """Squared error of every sample, (runs, T)."""
        return np.sum((run.x - self.record.x) ** 2, axis=-1)

    def run(self, estimator: Estimator, y: Float) -> Run:
        """Run an estimator on the record.

        Raises:
            ArithmeticError: a step did not converge to the estimator's own tolerance.
        """
        run = estimator.run(y, self.record.u, covariance=False)
        unsolved = np.count_nonzero(run.status == Status.NOT_CONVERGED)
        if unsolved:
            raise ArithmeticError(f"{estimator!r}: {unsolved} steps did not converge")
        return run

    def mean(self, samples: Float) -> Value:
        """Mean of (runs, T) samples after the burn-in, with the standard error of independent runs."""
        per_run = samples[:, self.config["simulation"]["burn_in"] :].mean(axis=1)
        return Value(float(per_run.mean()), float(per_run.std(ddof=1) / np.sqrt(len(per_run))))


@dataclass(frozen=True)
class Record:
    """Independent runs of the plant: states, inputs and clean measurements, each (runs, T, .)."""

    x: Float
    u: Float
    y: Float

    def attacked(self, sensor: int, size: float) -> Float:
        """Measurements with `size` added to one sensor (counted from 1) at every step."""
        y = self.y.copy()
        y[..., sensor - 1] += size
        return y

    def without(self, sensor: int) -> Float:
        """Measurements that lack one sensor (counted from 1)."""
        return self.attacked(sensor, np.nan)


def simulate(setting: Setting) -> Record:
    """Run the plant under u = −L x.

    A has the eigenvalue −2, so that an open-loop x grows as 2^k and double precision has lost the estimate
    near k = 50. The estimators are told u, so that the error x̂ − x does not depend on it: the feedback, which
    sees the true state, changes the size of x and nothing else.
    """
    plant, choice, scale = setting.plant, setting.config["simulation"], setting.scale
    runs, steps = scale["runs"], scale["steps"] + choice["burn_in"]
    rng = np.random.default_rng(choice["seed"])
    w = rng.multivariate_normal(np.zeros(plant.n), plant.Q, (runs, steps), method="cholesky")
    v = rng.multivariate_normal(np.zeros(plant.m), plant.R, (runs, steps), method="cholesky")
    x, u = np.empty((runs, steps, plant.n)), np.empty((runs, steps, plant.n_inputs))
    state = np.zeros((runs, plant.n))
    for k in range(steps):
        x[:, k], u[:, k] = state, -state * choice["feedback"]
        state = state @ plant.A.T + u[:, k] @ plant.B.T + w[:, k]
    return Record(x, u, x @ plant.C.T + v)

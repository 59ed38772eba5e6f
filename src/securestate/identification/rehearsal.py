"""The estimator that will be used, on a record in which nobody lied: whom does it suspect?

Innovations may be white and of the right size, and the model still not good enough: sparse fusion lets every
sensor estimate what it sees alone, and small errors of a model add up there.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from securestate.errors import DesignError, SecurestateWarning
from securestate.estimators.kalman import KalmanFilter
from securestate.estimators.sparse_fusion import SparseFusion
from securestate.identification.forms import Segment
from securestate.identification.residuals import WARM_UP, anywhere
from securestate.plant import Belief, Plant

#: Samples at most, and how many readings at most; a segment that is shorter than this is left out.
SAMPLES, READINGS, SHORTEST = 2000, 50_000, 60

#: Share of missing readings above which a steady-state method is not what one would use.
MISSING = 0.1


def suspected_shares(plant: Plant, record: Sequence[Segment]) -> NDArray[np.float64] | None:
    """Share of samples at which sparse fusion suspects each sensor, (N,); None if it does not apply.

    The first samples of a segment tell a Kalman filter where it starts.
    """
    long = [(y, u) for y, u in record if len(y) >= SHORTEST]
    if not long or np.mean(np.isnan(np.vstack([y for y, _ in long]))) > MISSING:
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SecurestateWarning)
        try:
            estimator = SparseFusion(plant)
        except DesignError:
            return None
        counts, left = np.zeros(plant.n_sensors), min(SAMPLES, READINGS // plant.m)
        total = 0
        for y, u in long:
            here = min(len(y), WARM_UP + left)
            if here <= WARM_UP:
                break
            suspected = _run(estimator, y[:here], u[:here])
            counts += suspected.sum(axis=0)
            total, left = total + len(suspected), left - len(suspected)
    return counts / max(total, 1)


def _run(estimator: SparseFusion, y: NDArray[np.float64], u: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Who is suspected after the first samples, (N - WARM_UP, sensors)."""
    plant = estimator.plant
    driven = bool(plant.n_inputs)
    first, then = slice(0, WARM_UP), slice(WARM_UP, None)
    known = KalmanFilter(plant).run(y[first], u[first] if driven else None, anywhere(plant), covariance=False)
    start = Belief(plant.successor(known.x[-1:], u[first][-1:])[0])
    return estimator.run(y[then], u[then] if driven else None, start, covariance=False).suspected

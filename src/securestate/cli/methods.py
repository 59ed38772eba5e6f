"""The estimators that the command line offers, ready to start without a prior."""

from __future__ import annotations

from collections.abc import Mapping

from securestate.errors import DesignError
from securestate.estimators import Estimator, KalmanFilter, SparseFusion
from securestate.plant import Plant

NAMES = ("sparse", "kalman")


def design(plant: Plant, name: str, choices: Mapping[str, object]) -> Estimator:
    """Design an estimator; `choices` are the settings that were given.

    Raises:
        DesignError: the plant does not allow the method, or it could not start without a prior.
        InputError: a setting is out of range.
    """
    if name == "sparse":
        return SparseFusion(plant, **choices)  # type: ignore[arg-type]
    estimator = KalmanFilter(plant)
    if estimator.steady is None:
        reason = f"the Kalman filter has no steady state to start from: {estimator.no_steady_state}"
        raise DesignError(reason, "or run it from Python with a prior: KalmanFilter(plant).run(y, u, prior)")
    return estimator

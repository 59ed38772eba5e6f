"""The Kalman filter: the best linear estimate when nobody lies."""

from __future__ import annotations

from typing import final

import numpy as np
from numpy.typing import NDArray

from securestate import _kernels
from securestate._steady_state import SteadyState, steady_state
from securestate.errors import DesignError, InputError
from securestate.estimators.base import Estimator
from securestate.plant import Plant

Float = NDArray[np.float64]


@final
class KalmanFilter(Estimator):
    """The Kalman filter: it trusts every sensor. Every secure estimator must equal it when nobody lies.

        x[k|k] = x[k|k-1] + K (y[k] - C x[k|k-1] - D u[k]),   x[k+1|k] = A x[k|k] + B u[k]

    Channels may be missing one by one (NaN). A and C may vary in time; sample k uses A[k] and C[k].

    Args:
        plant: any plant. Without a steady state, as when it varies in time, `run` and `start` need a prior
            with a covariance P.

    Attributes:
        steady: the steady state of the filter, or None.
        no_steady_state: why there is none; empty if there is one.

    Notes:
        `Run.diagnostics`: "log_likelihood" of the channels that arrived, in the units of C x;
        "nis", the normalised innovation squared, chi-square with as many degrees of freedom as channels
        arrived; "channels", how many that were.
        `Run.trust` is 1 where a sensor sent something, `Run.attack` NaN, `Run.suspected` False.
        P is kept as U D U', so that it stays positive semidefinite over any number of samples. In a plant
        that does not vary the gains are reused once P repeats itself to the rounding of one step.
        ILL_CONDITIONED: the covariance has grown beyond all numbers, because no sensor sees an unstable mode.

    References:
        Bierman 1977.

    Examples:
        >>> from securestate.plant import Belief, Plant, Sensor
        >>> plant = Plant([[1.0]], [[2.0]], [Sensor("level", C=[1.0], R=4.0)])
        >>> run = KalmanFilter(plant).run([[2.0], [float("nan")], [3.0]], prior=Belief([0.0], [[4.0]]))
        >>> print(run.x[:, 0], run.P[:, 0, 0])
        [1. 1. 2.2] [2. 4. 2.4]
    """

    steady: SteadyState | None

    def __init__(self, plant: Plant) -> None:
        self.steady, self.no_steady_state = steady_or_reason(plant)
        super().__init__(plant, _kernels.kalman(plant, prior_covariance(self.steady)), {})


def steady_or_reason(plant: Plant) -> tuple[SteadyState | None, str]:
    """The steady state and "", or None and why there is none.

    Raises:
        InputError: `plant` is no plant.
    """
    require_plant(plant)
    try:
        return steady_state(plant), ""
    except DesignError as reason:
        return None, str(reason)


def require_plant(plant: object) -> None:
    """Refuse what is no plant.

    Raises:
        InputError: it is none.
    """
    if not isinstance(plant, Plant):
        raise InputError("plant", "a Plant; Plant.load reads a file", type(plant).__name__)


def prior_covariance(steady: SteadyState | None) -> Float | None:
    """P[0|-1] of the steady state, as kernels take it."""
    return None if steady is None else steady.P_prior

"""The Kalman filter that hears protected sensors only, and tests all others against what they say."""

from __future__ import annotations

from typing import final

import numpy as np
from numpy.typing import NDArray

from securestate import _kernels
from securestate._steady_state import SteadyState
from securestate.errors import DesignError
from securestate.estimators._detectors import checked_rate, quantiles
from securestate.estimators.base import Estimator
from securestate.estimators.kalman import prior_covariance, require_plant, steady_or_reason
from securestate.plant import Plant

Float = NDArray[np.float64]


@final
class ProtectedKalman(Estimator):
    """A Kalman filter that hears only the sensors marked as protected. What any use of the others must beat.

    Every other sensor i is tested: r_i = y_i - C_i x[k|k] - D_i u has covariance V_i = C_i P[k|k] C_i' + R_i
    if it is honest, whatever anybody else sends (noise shared with protected sensors is taken out of both).

    Args:
        plant: any plant with at least one protected sensor. Without a steady state, as when it varies in
            time, `run` and `start` need a prior with P.
        false_alarm_rate: probability per sample that an honest sensor is suspected, in (0, 1).

    Attributes:
        steady: the steady state, or None.
        no_steady_state: why there is none; empty if there is one.

    Raises:
        DesignError: no sensor is protected.
        InputError: a setting is out of range.

    Notes:
        `Run.attack` is r_i, an estimate of the injection that assumes nothing about it, and `Run.attack_std`
        the root of the diagonal of V_i; both are 0 for protected sensors. `Run.suspected` says where
        r_i' V_i^-1 r_i exceeds its chi-square quantile q, and `Run.trust` is 1 / (1 + r_i' V_i^-1 r_i / q); 1
        for protected sensors. Trust is NaN where a sensor sent nothing or nothing is known of what it sees.
        `Run.diagnostics` are those of `KalmanFilter`, of the protected channels. `Run.innovation` is that of
        all channels.

    References:
        Chen, Weng, Ho, Yu 2022 (docs/bibliography.md: chen2022) call these sensors strong-defense.

    Examples:
        >>> from securestate import Plant, ProtectedKalman, Sensor
        >>> sensors = [Sensor("a", C=[1.0], R=1.0), Sensor("b", C=[1.0], R=1.0, protected=True)]
        >>> run = ProtectedKalman(Plant([[0.9]], [[1.0]], sensors)).run([[50.0, 0.1]])
        >>> print(run.suspected[0], run.attack[0].round(1), run.attack_std[0].round(1))
        [ True False] [49.9  0. ] [1.3 0. ]
    """

    steady: SteadyState | None

    def __init__(self, plant: Plant, *, false_alarm_rate: float = 0.01) -> None:
        rate = checked_rate(false_alarm_rate)
        self.steady, self.no_steady_state, alone = protected_alone(plant)
        kernel = _kernels.protected_kalman(plant, alone, quantiles(plant.m, rate))
        super().__init__(plant, kernel, {"false_alarm_rate": rate})


def protected_alone(
    plant: Plant,
) -> tuple[SteadyState | None, str, tuple[Plant, Float | None, list[int]]]:
    """Steady state of the protected sensors alone or None, why, and their plant as kernels take it.

    Raises:
        DesignError: no sensor is protected.
        InputError: `plant` is no plant.
    """
    require_plant(plant)
    sensors = np.flatnonzero(plant.protected).tolist()
    if not sensors:
        raise DesignError(
            "no sensor of this plant is protected",
            "mark sensors that nobody can tamper with as protected, or use a method that needs none",
        )
    selected = plant.select(sensors)
    steady, reason = steady_or_reason(selected)
    channels = np.flatnonzero(plant.protected[plant.channel_sensor]).tolist()
    return steady, reason, (selected, prior_covariance(steady), channels)

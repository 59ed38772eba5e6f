"""A Kalman filter on all sensors that hears those which may lie the less, the more they seem to.

A fixed compensation factor, as the joint fusion of Chen, Weng, Ho and Yu 2022 has it, hears a weak sensor
too little while it is honest and too much while it is not. Here the factor is estimated from the innovations,
given those of the protected sensors. Nothing is assumed about how a lie moves in time.
"""

from __future__ import annotations

from numbers import Real
from typing import final

from securestate import _kernels
from securestate._checks import whole_number
from securestate._steady_state import SteadyState
from securestate.errors import DesignError, InputError
from securestate.estimators import _detectors
from securestate.estimators._protected import warn_of_hidden_modes
from securestate.estimators.base import Estimator
from securestate.estimators.kalman import prior_covariance, steady_or_reason
from securestate.estimators.protected_kalman import ProtectedKalman
from securestate.plant import Plant

#: Longest window: every channel keeps as many numbers.
LONGEST = 10_000


@final
class AdaptiveJointFilter(Estimator):
    """A Kalman filter in which a sensor that is not protected has noise R_i + eta_i[k] on each channel.

    At every sample, after the protected channels are taken in,

        nu_j = innovation of weak channel j given theirs,   S_j = its variance when nobody lies
        eta_j = max(0, mean of nu_j^2 - S_j over the last `window` samples in which channel j arrived),
                at least nu_j^2 - S_j of this sample if nu_j^2 > gate S_j

    and then the weak channels are taken in with eta_j added to their noise. A sensor that is honest is heard
    nearly as in `KalmanFilter`, one that lies by much not at all.

    Args:
        plant: any plant with a protected sensor. Without a steady state, as when it varies in time, `run` and
            `start` need a prior with a covariance P.
        window: samples over which nu^2 - S is averaged, 1 to 10000. A long one hears honest sensors better,
            a short one notices sooner that a lie has begun or ended.
        gate: a sample counts at once where nu^2 > gate S; math.inf means never.
        false_alarm_rate: probability that an honest weak sensor is suspected at a sample, in (0, 1). The
            estimate of the state does not depend on it.

    Attributes:
        steady: the steady state of the Kalman filter on all sensors, or None. A run without a prior starts
            with its covariance: that of this filter where every eta is 0.
        no_steady_state: why there is none; empty if there is one.

    Raises:
        DesignError: no sensor is protected.
        InputError: a setting is out of range.

    Warns:
        SecurestateWarning: the protected sensors alone do not see a mode that does not fade; names it. A lie
            that moves along it changes no innovation that is used to judge. Not checked if the plant varies.

    Notes:
        `Run.attack` is nu for a weak channel, an unbiased estimate of the lie that assumes nothing about it,
        and `Run.attack_std` is sqrt(S). Both are 0 for a protected channel and NaN for a missing one.
        `Run.suspected`: nu_i' S_i^-1 nu_i of the channels of weak sensor i that arrived, given the protected
        ones, is above its chi-square quantile. `Run.trust` is 1 / (1 + that distance over that quantile):
        below one half exactly where the sensor is suspected; 1 for a protected sensor, NaN where nothing
        arrived.
        `Run.innovation_std` is that of nobody lying: sqrt diag(C P[k|k-1] C' + R).
        `Run.diagnostics`: "log_likelihood" and "nis" as in `KalmanFilter`, with the eta in use; "channels",
        how many arrived; "eta", the largest eta in use over the R of its channel, 0 if none is.
        P treats a lie as white noise of variance eta. Under a lie too small to be told from noise it is too
        small, most for a constant one (docs/adaptive-joint.md has figures).
        A weak reading further off than 1e140, in the units of C x, is taken to be that far off, and eta is at
        most 1e280: it then has no weight.
        NO_MEASUREMENT, ILL_CONDITIONED: as `KalmanFilter`.

    References:
        Chen, Weng, Ho, Yu 2022 (docs/bibliography.md: chen2022) for the setting of weak and protected
        sensors; Mehra 1970 (mehra1970) for noise estimated from innovations.

    Examples:
        >>> from securestate import AdaptiveJointFilter, Plant, Sensor
        >>> sensors = [Sensor("weak", C=[1.0], R=1.0), Sensor("guarded", C=[1.0], R=4.0, protected=True)]
        >>> run = AdaptiveJointFilter(Plant([[0.9]], [[1.0]], sensors)).run([[0.1, 0.3], [20.0, -0.2]])
        >>> print(run.suspected[:, 0], run.attack[1].round(1), run.attack_std[1].round(1))
        [False  True] [20.  0.] [1.4 0. ]
    """

    steady: SteadyState | None
    beside: ProtectedKalman

    def __init__(
        self, plant: Plant, *, window: int = 20, gate: float = 9.0, false_alarm_rate: float = 0.01
    ) -> None:
        self.steady, self.no_steady_state = steady_or_reason(plant)
        _require_protected(plant)
        settings = {
            "window": checked_window(window),
            "gate": checked_gate(gate),
            "false_alarm_rate": _detectors.checked_rate(false_alarm_rate),
        }
        kernel = _kernels.adaptive_joint(
            plant,
            prior_covariance(self.steady),
            window=int(window),
            gate=float(gate),
            quantiles=_detectors.quantiles(plant.m, false_alarm_rate),
        )
        warn_of_hidden_modes(plant)
        self.beside = ProtectedKalman(plant, false_alarm_rate=false_alarm_rate)
        super().__init__(plant, kernel, settings)


def _require_protected(plant: Plant) -> None:
    if not plant.protected.any():
        raise DesignError(
            "no sensor is protected, so there is nothing to judge the others by",
            "mark the sensors that nobody can tamper with (protected=True), or use SparseFusion",
        )


def checked_window(value: object) -> int:
    """A window as a number of samples.

    Raises:
        InputError: it is no whole number from 1 to `LONGEST`.
    """
    window = whole_number("window", value, 1, InputError)
    if window > LONGEST:
        raise InputError("window", f"a whole number up to {LONGEST}", str(window))
    return window


def checked_gate(value: object) -> float:
    """A gate as a number.

    Raises:
        InputError: it is no number > 0.
    """
    if isinstance(value, bool) or not isinstance(value, Real) or not float(value) > 0:
        raise InputError("gate", "a number > 0; math.inf for none", repr(value))
    return float(value)

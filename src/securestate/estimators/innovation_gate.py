"""The gate: a Kalman filter that leaves out every reading too far from its prediction."""

from __future__ import annotations

from typing import final

from securestate._steady_state import SteadyState
from securestate.estimators import _detectors
from securestate.estimators._consult import warn_of_limit
from securestate.estimators.base import Estimator
from securestate.estimators.kalman import steady_or_reason
from securestate.plant import Plant


@final
class InnovationGate(Estimator):
    """A Kalman filter that leaves out every sensor too far from the fused prediction.

        r_i = y_i - C_i x[k|k-1] - D_i u,   S_i = C_i P[k|k-1] C_i' + R_i
        sensor i is left out of sample k if r_i' S_i^-1 r_i > chi2(1 - false_alarm_rate; m_i)

    m_i counts the channels of sensor i that arrived. The rest is a Kalman update with the sensors that are
    left.

    Args:
        plant: any plant. Without a steady state, as when it varies in time, `run` and `start` need a prior
            with a covariance P.
        false_alarm_rate: probability that one sample of an honest sensor is left out, in (0, 1).

    Attributes:
        steady: the steady state of the Kalman filter, or None.
        no_steady_state: why there is none; empty if there is one.

    Raises:
        InputError: a setting is out of range.

    Notes:
        `Run.trust` is 1 for a sensor in use, 0 for one left out, NaN where it sent nothing. `Run.suspected`
        says who was left out, `Run.attack` is y - C x[k|k] - D u for them and 0 for the others;
        `Run.attack_std` is stated for them only.
        `Run.diagnostics`: "log_likelihood", "nis" and "channels" of the channels in use, as in
        `KalmanFilter`; "alarms", how many sensors were left out; "excess", the largest squared distance over
        its threshold.
        The rate holds up to the first alarm. After that alarms come a few per cent more often: leaving out an
        honest reading because it is far off cuts the tail of what enters x, which P does not know.
        A lie below the threshold passes for ever; a slow one takes the prediction along and stays below for
        long. Honest readings far from a prior that claims to know better are left out.
        A protected sensor is gated like any other: the classical detectors do not know who cannot lie.
        NO_MEASUREMENT: every sensor was left out or sent nothing. ILL_CONDITIONED: as `KalmanFilter`.

    References:
        Bar-Shalom, Li, Kirubarajan 2001 (docs/bibliography.md: barshalom2001).

    Examples:
        >>> from securestate import InnovationGate, Plant, Sensor
        >>> sensors = [Sensor(name, C=[1.0], R=1.0) for name in ("a", "b", "c")]
        >>> run = InnovationGate(Plant([[0.9]], [[1.0]], sensors)).run([[0.1, -0.2, 50.0]])
        >>> print(run.suspected[0], run.attack[0].round(1))
        [False False  True] [ 0.  0. 50.]
    """

    steady: SteadyState | None

    def __init__(self, plant: Plant, *, false_alarm_rate: float = 0.01) -> None:
        self.steady, self.no_steady_state = steady_or_reason(plant)
        rate = _detectors.checked_rate(false_alarm_rate)
        kernel = _detectors.kernel(plant, self.steady, "gate", rate)
        super().__init__(plant, kernel, {"false_alarm_rate": rate})
        warn_of_limit(plant)

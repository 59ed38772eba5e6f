"""The chi-square detector on every sensor's own filter, or on all channels at once."""

from __future__ import annotations

from typing import Literal, final

from securestate._local_filters import local_filters
from securestate._steady_state import SteadyState
from securestate.errors import InputError
from securestate.estimators import _detectors
from securestate.estimators._consult import warn_of_limit
from securestate.estimators.base import Estimator
from securestate.estimators.kalman import steady_or_reason
from securestate.plant import Plant

#: What can be done about an alarm; the first of each is the default.
ON_ALARM: dict[str, tuple[_detectors.Rule, ...]] = {
    "sensor": ("drop", "hold"),
    "central": ("predict", "drop-worst"),
}


@final
class ChiSquareFilter(Estimator):
    """A Kalman filter behind a chi-square detector.

    scope="sensor": every sensor has a steady-state filter of its own on what it can see of the state. If

        r_i' S_i^-1 r_i > chi2(1 - false_alarm_rate; m_i),   r_i = y_i - C_i z_i[k|k-1] - D_i u

    with that filter's innovation r_i and its steady-state covariance S_i, the sensor is left out of this
    sample.

    scope="central": one test on the innovation of all m channels that arrived, about the fused prediction,

        r' S^-1 r > chi2(1 - false_alarm_rate; m),   S = C P[k|k-1] C' + R

    Args:
        plant: for scope "sensor" a plant that does not vary, in which each sensor alone has a steady-state
            filter. For "central" any plant; without a steady state `run` and `start` need a prior with P.
        scope: which test.
        on_alarm: for "sensor": "drop" (default), the filter of an alarmed sensor goes on listening; "hold",
            it does not take in the alarmed reading either. For "central": "predict" (default), nothing of
            this sample is used; "drop-worst", sensors are left out one by one until the test passes on the
            rest with its own degrees of freedom, the one first whose r_i' S_i^-1 r_i (as in `InnovationGate`)
            is largest in proportion to its own threshold.
        false_alarm_rate: probability per sample that an honest sensor ("sensor"), or anybody when all are
            honest ("central"), raises an alarm, in (0, 1).

    Attributes:
        steady: the steady state of the fused Kalman filter, or None.
        no_steady_state: why there is none; empty if there is one.

    Raises:
        DesignError: scope "sensor" and the plant varies, or a sensor has no filter of its own; names it.
        InputError: a setting is out of range, or on_alarm belongs to the other scope.

    Notes:
        `Run.trust` is 1 for a sensor in use, 0 for one left out, NaN where it sent nothing. `Run.suspected`
        says who was left out, `Run.attack` is y - C x[k|k] - D u for them and 0 for the others;
        `Run.attack_std` is stated for them only. With "predict" an alarm suspects every sensor that arrived,
        because the test does not say who lies.
        `Run.diagnostics`: "log_likelihood", "nis" and "channels" of the channels in use, as in
        `KalmanFilter`; "alarms", how many sensors were left out; "excess", the largest squared distance over
        its threshold, for "central" that of all channels that arrived.
        Missing channels: the test takes those that arrived, with as many degrees of freedom. A sensor's own
        filter takes in complete readings only and predicts otherwise; its test is then a little too strict
        until the filter has settled again.
        "hold" does not keep the stated rate: a filter that did not hear a reading is worse at the next one,
        and its steady-state threshold does not know it. Where modes fade quickly the rate is up to doubled;
        where they do not, an honest sensor can stay alarmed for long (docs/detectors.md has figures).
        A protected sensor is tested like any other: the classical detectors do not know who cannot lie.
        NO_MEASUREMENT: every sensor was left out or sent nothing. ILL_CONDITIONED: as `KalmanFilter`.

    References:
        Mehra, Peschon 1971 (docs/bibliography.md: mehra1971).

    Examples:
        >>> from securestate import ChiSquareFilter, Plant, Sensor
        >>> sensors = [Sensor(name, C=[1.0], R=1.0) for name in ("a", "b", "c")]
        >>> plant = Plant([[0.9]], [[1.0]], sensors)
        >>> for estimator in (ChiSquareFilter(plant), ChiSquareFilter(plant, scope="central")):
        ...     run = estimator.run([[0.1, -0.2, 50.0]])
        ...     print(run.suspected[0], run.x[0].round(2))
        [False False  True] [-0.04]
        [ True  True  True] [0.]
    """

    steady: SteadyState | None

    def __init__(
        self,
        plant: Plant,
        *,
        scope: Literal["sensor", "central"] = "sensor",
        on_alarm: Literal["drop", "hold", "predict", "drop-worst"] | None = None,
        false_alarm_rate: float = 0.01,
    ) -> None:
        self.steady, self.no_steady_state = steady_or_reason(plant)
        rate = _detectors.checked_rate(false_alarm_rate)
        rule = _checked_rule(scope, on_alarm)
        filters = local_filters(plant) if scope == "sensor" else ()
        kernel = _detectors.kernel(plant, self.steady, rule, rate, filters)
        super().__init__(plant, kernel, {"scope": scope, "on_alarm": rule, "false_alarm_rate": rate})
        warn_of_limit(plant)


def _checked_rule(scope: str, on_alarm: str | None) -> _detectors.Rule:
    """What to do about an alarm, if the scope knows it."""
    if scope not in list(ON_ALARM):
        raise InputError("scope", '"sensor" or "central"', repr(scope))
    known = ON_ALARM[scope]
    if on_alarm is None:
        return known[0]
    for rule in known:
        if rule == on_alarm:
            return rule
    choices = " or ".join(f'"{name}"' for name in known)
    raise InputError("on_alarm", f'{choices} for scope="{scope}"', repr(on_alarm))

"""SecureFilter: the estimator to recommend."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np
from numpy.typing import NDArray
from scipy import special

from securestate import _kernels
from securestate._steady_state import SteadyState
from securestate.errors import InputError
from securestate.estimators import _detectors
from securestate.estimators._consult import warn_of_limit
from securestate.estimators._mixture_design import refuse_shared_noise
from securestate.estimators.base import Estimator
from securestate.estimators.kalman import prior_covariance, steady_or_reason
from securestate.plant import Plant

Float = NDArray[np.float64]

#: Variance of a wild lie, in units of what the other sensors leave open; the kernel's `BROAD`.
BROAD = 15.0

#: A single sample accuses a sensor that was honest from its chi-square quantile on, plus this share of that
#: of one channel: room for what memory and learned lies add to the rate of false accusations.
MARGIN = 0.3

#: A filter that may suspect everybody says nothing.
HIGHEST_RATE = 0.1

#: Share of the false alarm rate at which honest sensors are taken to begin a steady lie.
STEADY = 0.1


@final
class SecureFilter(Estimator):
    """Finds who lies, remembers it, and estimates the state as if the liars were known. The one to recommend.

    At every sample each sensor is believed to be honest or to lie in one of three ways:

        honest      r_i ~ N(C_i e, R_i),  r_i = y_i - C_i x[k|k-1] - D_i u,  e ~ N(0, P[k|k-1])
        constant    r_i ~ N(C_i e + b_i, (1.5 + s_i) R_i),  b_i, s_i: what it injected so far
        drifting    rho_i ~ N(b_i, V_i + s_i R_i),  rho_i, V_i: r_i less what the others expect
        wild        rho_i ~ N(0, 16 V_i), or the common spread of those who lie at this sample

    The beliefs are those of `InnovationMixture`, by expectation propagation, with memory: habits of lying
    (for long, for a few samples, or anew every time) are learned from all sensors, and injections are
    followed. A sensor that lies by a constant is used again, less its injection. Sweeps begin from what is
    remembered, from a gate on the prediction and, if it is news who lies, from a robust regression; where two
    labellings are close, x is their mean and P holds how far they are apart. If the accused are too many to
    be the liars for three samples, the filter tries again without its memory, P[k|k-1] inflated.

    Args:
        plant: any plant whose R correlates no two sensors. Without a steady state, as when it varies in time,
            `run` and `start` need a prior with a covariance P. Protected sensors are always believed.
        false_alarm_rate: share of the samples of an honest sensor at which it may be suspected while nobody
            lies, in (0, 0.1]. Measured within a factor of 1.5 for scalar sensors, less often for those with
            several channels (docs/secure-filter.md). The only knob: all else follows from it or is the same
            for every plant.

    Attributes:
        steady: the steady state of the Kalman filter, or None.
        no_steady_state: why there is none; empty if there is one.

    Raises:
        DesignError: R correlates two sensors.
        InputError: the rate is out of range.

    Notes:
        `Run.trust` is the belief that a sensor is honest, 1 for a protected one, NaN where nothing arrived;
        `Run.suspected` is a trust below one half. The channels of a sensor are honest or not together.
        `Run.attack` of a suspected sensor is its injection, in sensor units: what is remembered of a steady
        one, of a wild one y less what the others expect; `Run.attack_std` is its standard deviation. 0 for
        the others, NaN where nothing arrived.
        `Run.diagnostics`: "channels" that arrived; "sweeps" and "gap", how many and the largest change of a
        belief in the last; "distrusted", how many sensors are suspected; "rival", weight of a second
        labelling that was merged.
        While others lie, honest sensors are suspected more often: until the liars are named, x is theirs too.
        A lie that grows is followed from behind, by up to some `attack_std`; of a constant one `attack_std`
        is honest.
        An innovation further off than 1e6 standard deviations is judged as if it were that far off, unless
        the sensor is protected.
        NO_MEASUREMENT and ILL_CONDITIONED: as `InnovationMixture`. MAJORITY_SUSPECT: the accused are
        no minority, or outweigh all that is believed along one line of the state. AMBIGUOUS: a second
        labelling has a weight of at least .05 and is more than one standard deviation away in some state.
        NOT_CONVERGED: beliefs still move by over .05.

    References:
        Minka 2001 (docs/bibliography.md: minka2001); Blom, Bar-Shalom 1988 (blom1988). docs/secure-filter.md
        says how it works, what was measured, and where another estimator is better.

    Examples:
        >>> from securestate import Plant, SecureFilter, Sensor
        >>> sensors = [Sensor(name, C=[1.0], R=1.0) for name in "abcde"]
        >>> run = SecureFilter(Plant([[0.9]], [[1.0]], sensors)).run([[0.1, -0.2, 20.0, 0.3, 19.0]])
        >>> print(run.suspected[0], run.attack[0].round(1), run.attack_std[0].round(1))
        [False False  True False  True] [ 0.  0. 20.  0. 19.] [nan nan 1.1 nan 1.1]
    """

    steady: SteadyState | None

    def __init__(self, plant: Plant, *, false_alarm_rate: float = 1e-3) -> None:
        rate = _detectors.checked_rate(false_alarm_rate)
        if rate > HIGHEST_RATE:
            raise InputError("false_alarm_rate", f"at most {HIGHEST_RATE:g}", f"{rate:g}")
        self.steady, self.no_steady_state = steady_or_reason(plant)
        refuse_shared_noise(plant)
        super().__init__(plant, kernel(plant, self.steady, rate), {"false_alarm_rate": rate})
        warn_of_limit(plant)


def kernel(
    plant: Plant, steady: SteadyState | None, false_alarm_rate: float, without: Sequence[str] = ()
) -> _kernels.Kernel:
    """The kernel of a plant; `without` names parts to leave out, to measure what they are worth."""
    sizes = np.bincount(plant.channel_sensor, minlength=plant.n_sensors)
    return _kernels.secure_filter(
        plant,
        prior_covariance(steady),
        onset=onset_probability(sizes, false_alarm_rate),
        steady=STEADY * false_alarm_rate,
        deviations=np.ascontiguousarray(np.sqrt(np.diag(plant.R))),
        without=list(without),
    )


def onset_probability(channels: NDArray[np.intp], false_alarm_rate: float) -> Float:
    """Probability per sample that a sensor with so many channels begins to lie.

    The one for which a single sample is as likely a lie as not where rho' V^-1 rho reaches the chi-square
    quantile of `false_alarm_rate` and the `MARGIN`, if a lie multiplies V by 1 + `BROAD`. So broad a density
    says little of many channels at once: they get no more than one channel.
    """
    m = np.append(1.0, np.asarray(channels, dtype=np.float64))
    threshold = special.chdtri(m, false_alarm_rate) + MARGIN * special.chdtri(1, false_alarm_rate)
    odds = 0.5 * m * np.log1p(BROAD) - 0.5 * threshold * BROAD / (1 + BROAD)
    return np.ascontiguousarray(special.expit(np.minimum(odds[1:], odds[0])))

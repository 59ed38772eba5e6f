"""The innovation mixture: who lies may change at every sample (recommended after Zhu et al. 2022)."""

from __future__ import annotations

from numbers import Real
from typing import final

import numpy as np
from numpy.typing import NDArray
from scipy import special

from securestate import _kernels
from securestate._checks import yes_or_no
from securestate._steady_state import SteadyState
from securestate.errors import InputError
from securestate.estimators import _detectors
from securestate.estimators._consult import warn_of_limit
from securestate.estimators._mixture_design import one_of, refuse_shared_noise
from securestate.estimators.base import Estimator
from securestate.estimators.kalman import prior_covariance, steady_or_reason
from securestate.plant import Plant

Float = NDArray[np.float64]

#: Degrees of freedom of Student's density.
DEGREES = 1.0

#: Sweeps at most, and the change of beliefs that ends them, by form.
SWEEPS = {"propagation": (15, 1e-3), "belief": (8, 1e-4)}


@final
class InnovationMixture(Estimator):
    """Weighs every sensor by the belief that its present sample is honest; who lies may change every time.

        sensor i is honest:     r_i ~ N(C_i e, R_i),  r_i = y_i - C_i x[k|k-1] - D_i u,  e ~ N(0, P[k|k-1])
        sensor i is attacked:   S_i^-1/2 r_i ~ N(mu, tau^2 I),  S_i = C_i P[k|k-1] C_i' + R_i

    mu and tau are learned from the sample, with one pseudo-observation at 0 of variance `kappa`. The belief
    in a sensor compares both densities given what all others say (leave one out), and what others say depends
    on the beliefs in them: expectation propagation sweeps until both agree. An undecided sensor enters the
    others as the Gaussian with the first two moments of its mixture. Sweeps begin from two opposite beliefs,
    a gate on the prediction and trust in all. Labellings that differ are compared by their exact evidence,
    less a penalty where fewer than half of the sensors are honest. If two are close, x is their mean and P
    holds how far they are apart.

    Args:
        plant: any plant whose R correlates no two sensors. Without a steady state, as when it varies in time,
            `run` and `start` need a prior with a covariance P. Protected sensors are always believed.
        form: "propagation", or "belief" for the plain belief weighting it improves on, in which an undecided
            sensor counts as one whose noise is larger by 1 / belief.
        attacked: "learned", or "student" for Student's t with one degree of freedom and scale `kappa`.
        memory: "rate" gives every sensor a probability of an attack from how often its samples alone, without
            what is remembered, looked like lies lately; "doubt" from how much it was doubted, so that doubt
            feeds on itself; "sticky" has chances of beginning and of ending to lie, learned from all sensors:
            better against a set that stays, worse where few sensors see a state, because it locks in.
        merge: False takes the labelling of larger evidence even if another is close.
        kappa: prior variance of an attacked innovation, in units of S_i. A larger one costs less without an
            attack and finds small injections later.
        forgetting: of the past of each sensor, per sample, in (0, 1).
        monitor: None, or the forgetting in (0, 1) of a monitor for small persistent biases. It averages what
            the others do not expect of a sensor; a minority at most that is too far off is not believed.
        monitor_rate: probability that the monitor finds an honest sensor too far off at a sample, in (0, 1).

    Attributes:
        steady: the steady state of the Kalman filter, or None.
        no_steady_state: why there is none; empty if there is one.

    Raises:
        DesignError: R correlates two sensors.
        InputError: a setting is out of range.

    Notes:
        `Run.trust` is the belief, 1 for a protected sensor, NaN where nothing arrived; `Run.suspected` is a
        belief below one half. The channels of a sensor are honest or attacked together.
        `Run.attack` of a suspected sensor is y less what the others expect of it, in sensor units, and
        `Run.attack_std` its standard deviation; 0 for the others, NaN where nothing arrived.
        `Run.diagnostics`: "channels" that arrived; "sweeps"; "gap", the largest change of a belief in the
        last sweep; "distrusted", how many sensors are suspected; "rival", weight of the labelling merged.
        An innovation further off than 1e6 standard deviations is judged as if it were that far off, unless
        the sensor is protected.
        P is kept as a square root, so that it stays positive semidefinite whatever the rounding.
        NO_MEASUREMENT: as `KalmanFilter`. ILL_CONDITIONED: so too, and where the variance of an innovation is
        above 1e13 times that of its noise, so that rounding counts: give a prior that knows more.
        MAJORITY_SUSPECT: more than half of the sensors that arrived are suspected. AMBIGUOUS: a second
        labelling has a weight of at least .05 and is more than one standard deviation away in some state, or
        at least half of the beliefs lie between 1/3 and 2/3. NOT_CONVERGED: beliefs still move by over .05.

    References:
        After Zhu, Wang, Zang, Li, Zheng 2022 (docs/bibliography.md: zhu2022); Minka 2001 (minka2001).
        docs/mixture-fusion.md says what is different from the paper, and why.

    Examples:
        >>> from securestate import InnovationMixture, Plant, Sensor
        >>> sensors = [Sensor(name, C=[1.0], R=1.0) for name in "abcde"]
        >>> run = InnovationMixture(Plant([[0.9]], [[1.0]], sensors)).run([[0.1, -0.2, 20.0, 0.3, 19.0]])
        >>> print(run.suspected[0], run.attack[0].round(1), run.attack_std[0].round(1))
        [False False  True False  True] [ 0.   0.  19.9  0.  18.9] [nan nan 1.1 nan 1.1]
    """

    steady: SteadyState | None

    def __init__(
        self,
        plant: Plant,
        *,
        form: str = "propagation",
        attacked: str = "learned",
        memory: str = "rate",
        merge: bool = True,
        kappa: float = 5.0,
        forgetting: float = 0.98,
        monitor: float | None = None,
        monitor_rate: float = 1e-4,
    ) -> None:
        self.steady, self.no_steady_state = steady_or_reason(plant)
        refuse_shared_noise(plant)
        settings = {
            "form": one_of("form", form, ("propagation", "belief")),
            "attacked": one_of("attacked", attacked, ("learned", "student")),
            "memory": one_of("memory", memory, ("rate", "doubt", "sticky")),
            "merge": yes_or_no("merge", merge, InputError),
            "kappa": _between("kappa", kappa, 1e-6, 1e12),
            "forgetting": _between("forgetting", forgetting, 0.0, 1.0),
            "monitor": None if monitor is None else _between("monitor", monitor, 0.0, 1.0),
            "monitor_rate": _between("monitor_rate", monitor_rate, 0.0, 1.0),
        }
        widest = int(np.bincount(plant.channel_sensor, minlength=plant.n_sensors).max())
        cap, tolerance = SWEEPS[form]
        kernel = _kernels.innovation_mixture(
            plant,
            prior_covariance(self.steady),
            form=form,
            attacked=attacked,
            memory=memory,
            merge=merge,
            kappa=float(kappa),
            forgetting=float(forgetting),
            cap=cap,
            tolerance=tolerance,
            student=(DEGREES, _student(widest, float(kappa))),
            monitor=(
                None if monitor is None else float(monitor),
                _detectors.quantiles(widest, float(monitor_rate)),
            ),
        )
        super().__init__(plant, kernel, settings)
        warn_of_limit(plant)


def _student(channels: int, kappa: float) -> Float:
    """Log constant of t_nu with scale kappa less that of N(0, I) in 0, 1, ... dimensions, (channels + 1,)."""
    m = np.arange(channels + 1)
    gamma = special.gammaln((DEGREES + m) / 2) - special.gammaln(DEGREES / 2)
    return np.asarray(gamma - m / 2 * np.log(DEGREES * kappa / 2), dtype=np.float64)


def _between(name: str, value: object, low: float, high: float) -> float:
    if isinstance(value, bool) or not isinstance(value, Real) or not low < float(value) < high:
        raise InputError(name, f"a number in ({low:g}, {high:g})", repr(value))
    return float(value)

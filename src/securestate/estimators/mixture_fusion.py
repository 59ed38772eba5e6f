"""Mixture fusion: local estimates clustered by a Gaussian mixture, sensors weighted by what that says.

    local estimate   x_i = x_i^- + Pbar_i C_i' R_i^-1 (y_i - C_i x_i^-)                             (8), (10)
    mixture          p(x_i) = pi_1 N(x_i; mu_1, Pbar_i) + pi_2 N(x_i; mu_2, Sigma_2)                     (13)
    belief           gamma_i = pi_1 N(x_i; mu_1, Pbar_i) / p(x_i)                                  (15), (16)
    maximisation     pi, mu_1, mu_2, Sigma_2 from the beliefs                                       (17)-(19)
    compensator      gammahat_i = 1 - gamma_i if mean(1 - gamma) > epsilon, else gamma_i           (20), (21)
    fusion           P^-1 = (P^-)^-1 + sum gammahat_i C_i' R_i^-1 C_i                                   (22d)
                     x = x^- + P sum gammahat_i C_i' R_i^-1 (y_i - C_i x^-)                             (22c)

References:
    Zhu, Wang, Zang, Li, Zheng 2022 (docs/bibliography.md: zhu2022), Algorithm 1; epsilon=None is the method
    of Guo, Shi, Quevedo, Shi 2019 (guo2019).
Deviations from the paper:
    * (22d) is printed with gamma, (22c) with gammahat. Where the two differ that multiplies the error, by
      about -30 in the example of the paper; gammahat goes into both. literal=True is (22d) as printed.
    * (7) and (8) mean P^- of sample k, not k - 1; the second factor of (19) lacks its hat.
    * Not in the paper: where pi and mu_1 start (`init`), when the iteration stops, what bounds Sigma_2 from
      below (`floor`), inputs, missing channels, a Pbar_i without an inverse.
    * (18) is not the maximiser where the Pbar_i differ; mean="precision" is.
"""

from __future__ import annotations

from numbers import Real
from typing import Literal, final

from securestate import _kernels
from securestate._checks import whole_number, yes_or_no
from securestate._steady_state import SteadyState
from securestate.errors import DesignError, InputError
from securestate.estimators._consult import warn_of_limit
from securestate.estimators._mixture_design import local_priors, one_of, refuse_shared_noise
from securestate.estimators.base import Estimator
from securestate.estimators.kalman import prior_covariance, steady_or_reason
from securestate.plant import Plant

#: Where mu_1 can start.
INITS = ("split", "median", "mean", "prediction")

#: Ways to average the points of the honest component.
MEANS = ("printed", "precision")

#: What can be added to the diagonal of Sigma_2.
FLOORS = ("printed", "prior")


@final
class MixtureFusion(Estimator):
    """A Kalman filter that weighs sensors by how well their own estimates of the state cluster.

    Every sensor runs a steady-state Kalman filter on the whole state. At every sample a mixture of two
    Gaussians is fitted to the estimates x_i of those sensors that sent something: the honest ones scatter
    with the covariances Pbar_i of their filters, the attacked ones with any mean and covariance. The belief
    that sensor i is honest weighs its reading in the fused filter.

    Args:
        plant: a plant that does not vary, in which every sensor alone can estimate the whole state, and the
            noise of different sensors is independent. Without a steady state of the fused filter `run` and
            `start` need a prior with a covariance P.
        epsilon: above this mean belief in an attack the two components are taken to be confused, and all
            beliefs are swapped, in [0, 1]. It should be at least the share of sensors that may be attacked.
            None, or "none" in files: never, as Guo et al. 2019 have it.
        init: where mu_1 starts. "split": one standard deviation of the estimates from their mean along the
            direction in which they differ most, mu_2 opposite; mu_1 is smaller in the state that this
            direction is closest to. "median": state by state. "mean". "prediction": x[k|k-1]. mu_2 is
            otherwise the mean; Sigma_2 is the covariance of the estimates, pi one half.
        literal: use the beliefs before they are swapped in (22d), as printed. For study: errors explode.
        start: samples before which every sensor is believed, as the systems of the paper reach their steady
            state before anybody attacks.
        mean: mu_1 as (18) prints it, or "precision": weighted with Pbar_i^-1, which maximises the likelihood.
        floor: what is added to the diagonal of Sigma_2, without which the likelihood has no bound: "printed":
            1e-9 max(1, tr Sigma_2); "prior": the mean variances of Pbar_i.
        feedback: let every sensor's own estimate start from the fused prediction and its covariance at every
            sample, so that it remembers nothing of earlier attacks. Pbar_i is then of this sample, and no
            sensor needs a filter of its own.
        cap: iterations at most, per sample.

    Attributes:
        steady: the steady state of the fused Kalman filter, or None.
        no_steady_state: why there is none; empty if there is one.

    Raises:
        DesignError: the plant varies, the noise of two sensors is correlated, or without feedback a sensor
            cannot estimate the whole state alone; names it.
        InputError: a setting is out of range.

    Notes:
        `Run.trust` is gammahat, NaN where a sensor sent nothing; `Run.suspected` is trust < 1/2; `Run.attack`
        is y - C x[k|k] - D u for who is suspected and 0 for the others. The method does not state how sure
        that is: `Run.attack_std` is NaN.
        `Run.diagnostics`: "log_likelihood" of the mixture (14), NaN where none was fitted; "iterations";
        "mean_attacked", the mean of 1 - gamma; "swapped", 1 where the compensator swapped; "gap", the change
        of the likelihood in the last iteration relative to 1 + its size; "channels", how many arrived.
        A sensor that sent only some channels is judged and heard by these: its own estimate and Pbar_i are
        those after one correction of the steady prediction. While a sensor sends nothing its own filter
        predicts, and Pbar_i does not know that it has grown worse. With fewer than two sensors nobody is
        judged.
        A belief that is 1 for everybody gives the Kalman filter to the bit.
        Where Pbar_i has no inverse, no state counts as known to less than 1e-12 of its variance.
        A protected sensor is judged like any other: the method does not know who cannot lie.
        Readings beyond 1e100, in the units of C x, count as 1e100.
        NO_MEASUREMENT, ILL_CONDITIONED: as `KalmanFilter`.
        NOT_CONVERGED: the iteration stopped at its cap; the beliefs are those of its last step.
        MAJORITY_SUSPECT: more than half of the sensors that sent something are suspected, converged or not.
        BROKEN_DOWN: the literal form would have led x beyond 1e100, and gammahat went into (22d) this time;
            or the estimates are too far apart for the likelihood to be a number, and everybody is believed.

    References:
        Zhu, Wang, Zang, Li, Zheng 2022 (docs/bibliography.md: zhu2022); Guo, Shi, Quevedo, Shi 2019
        (guo2019).

    Examples:
        >>> from securestate import MixtureFusion, Plant, Sensor
        >>> sensors = [Sensor(name, C=[1.0], R=1.0) for name in "abcde"]
        >>> run = MixtureFusion(Plant([[0.9]], [[1.0]], sensors)).run([[0.1, -0.2, 50.0, 0.3, 49.0]])
        >>> print(run.suspected[0], run.x[0].round(2))
        [False False  True False  True] [0.05]
    """

    steady: SteadyState | None

    def __init__(
        self,
        plant: Plant,
        *,
        epsilon: float | Literal["none"] | None = 0.5,
        init: Literal["split", "median", "mean", "prediction"] = "split",
        literal: bool = False,
        start: int = 0,
        mean: Literal["printed", "precision"] = "printed",
        floor: Literal["printed", "prior"] = "printed",
        feedback: bool = False,
        cap: int = 100,
    ) -> None:
        self.steady, self.no_steady_state = steady_or_reason(plant)
        settings: dict[str, object] = {
            "epsilon": (threshold := _checked_epsilon(epsilon)),
            "init": one_of("init", init, INITS),
            "literal": yes_or_no("literal", literal, InputError),
            "start": whole_number("start", start, 0, InputError),
            "mean": one_of("mean", mean, MEANS),
            "floor": one_of("floor", floor, FLOORS),
            "feedback": yes_or_no("feedback", feedback, InputError),
            "cap": whole_number("cap", cap, 1, InputError),
        }
        if plant.time_varying:
            raise DesignError("mixture fusion needs a time-invariant plant", "give constant A and C")
        refuse_shared_noise(plant)
        kernel = _kernels.mixture_fusion(
            plant,
            prior_covariance(self.steady),
            None if feedback else local_priors(plant),
            epsilon=threshold,
            literal=literal,
            start=int(start),
            init=init,
            precise=mean == "precision",
            prior_floor=floor == "prior",
            cap=int(cap),
        )
        super().__init__(plant, kernel, settings)
        warn_of_limit(plant)


def _checked_epsilon(value: object) -> float | None:
    if value is None or (isinstance(value, str) and value == "none"):
        return None
    if isinstance(value, bool) or not isinstance(value, Real) or not 0 <= float(value) <= 1:
        raise InputError("epsilon", "a number in [0, 1], or None", repr(value))
    return float(value)

"""Small constant biases by the generalised likelihood ratio on the innovations of the steady Kalman filter.

    effect of a unit bias on channel i, j samples after its onset, on the whitened innovations
        s_{i,j} = L^-1 (e_i - C Z_j),  Z_0 = 0,  Z_{j+1} = F Z_j + A K e_i,  F = A (I - K C),  S = L L'
    its standardised effect if it began k samples ago, where lambda_{i,k} = sum_{j<k} |s_{i,j}|^2
        z_{i,k}(t) = sum_{j<k} s_{i,j}' eps_{t-k+1+j} / sqrt(lambda_{i,k})
    penalised ratio
        g_i(t) = max_k [ z_{i,k}^2 / gamma - 2 kappa ln(40 / k) ],   k = 1 .. 40,   kappa = 1.5
    sensor i is named if g_i > limit and g_i - max_{j != i} g_j > 4 at three samples in a row

A sensor's ratio is the largest of its channels. From then on the onset stays; the sizes b of all biases are
estimated together by least squares over all samples since their onsets, and leave innovations and state.

References:
    Willsky, Jones 1976 (docs/bibliography.md: willsky1976).
Deviations from the paper:
    * It looks for jumps of the state; here the jump is a constant on one sensor, and sensors compete.
    * Every onset of the window competes, the present sample included, hence the penalty: of two onsets with
      equal ratios the older one wins. A sparse grid of onsets names the wrong sensor more often.
    * The limit comes from a simulation of the model, not from the chi-square table: a maximum over sensors
      and onsets is not chi-square. See `_bias_design`.
    * The paper changes its filter after a detection. Here the filter runs on and the biases' effects are
      taken off what it says: the same estimate, and a bias that turns out to be none leaves no trace.
    * The end of a bias is a second step on the same channel. What a sensor adds is the sum of its steps;
      two whose difference the filter has forgotten become one, or none if nothing is left of them.
"""

from __future__ import annotations

import warnings
from typing import final

from securestate import _checks as check
from securestate._steady_state import SteadyState, steady_state
from securestate.errors import DesignError, InputError, SecurestateWarning
from securestate.estimators import _bias_design as design
from securestate.estimators.base import Estimator
from securestate.estimators.kalman import require_plant
from securestate.plant import Plant

#: Share of missing samples above which a steady-state filter is the wrong tool.
MISSING_LIMIT = 0.1
#: Least run length: below it an episode is hardly over when the next one is due.
LEAST_RUN_LENGTH = 100.0


@final
class BiasMonitor(Estimator):
    """The steady Kalman filter, and a test that finds biases of less than a standard deviation.

    It gathers evidence over up to 40 samples, names the sensor, estimates what it adds, and takes it off the
    state. While nobody is suspected the estimate is that of the Kalman filter in steady state.

    Args:
        plant: a plant that does not vary in time, with a steady state and at least two sensors. A sensor
            with `verifiable=False` that is not protected is never named.
        run_length: samples from one false alarm to the next on average while nobody lies, at least 100.
        calibrate_on: records (T, m) during which nobody lied and which the model was not fitted to, in the
            units of the sensors, or a list of them; with inputs, a pair (y, u), or a list of pairs. None:
            the model is taken as exact.

    Attributes:
        steady: the steady state of the Kalman filter.
        limit: the ratio that a sensor must pass to be named, at least 9.
        gamma: variance of the innovations over that of the model, >= 1; 1 without `calibrate_on`.

    Raises:
        DesignError: the plant varies in time, has no steady state or a single sensor; or its model is
            inadequate.
        InputError: a setting is out of range.

    Notes:
        `Run.suspected` is True for a sensor while its bias is significant (three standard deviations);
        `Run.attack` is the bias, 0 for the others and NaN where nothing came, `Run.attack_std` is stated for
        the suspected only. `Run.innovation` is what remains after the biases that the sample before knew of.
        `Run.trust` is 1 - exp(g_i / 2) / (exp(limit / 2) + sum_j exp(g_j / 2)), one half for a sensor that
        alone reaches the limit; for a suspected one 1 / (1 + exp((b^2 / var b - 9) / 2)), below one half.
        `Run.P` adds what is not known of the biases to the steady covariance.
        `Run.diagnostics`: "leader", the number of the sensor with the largest ratio; "ratio", that ratio;
        "ahead", how far the next sensor is behind; "biases", how many steps are taken off, at most four;
        "channels", how many arrived.
        A missing channel is replaced by its mean given the others, so that it says nothing; P stays that of
        the steady state. Above about 10 % missing samples use a time-varying filter (`run` warns).
        A reading more than 1e9 standard deviations from its prediction is held at that distance.
        AMBIGUOUS: something is wrong, and no sensor is ahead of all others, or the one ahead cannot be
        checked, or four steps are known already: nobody is named, and P does not include what is wrong.
        NO_MEASUREMENT: nothing arrived.

    References:
        Willsky, Jones 1976 (docs/bibliography.md: willsky1976).

    Examples:
        >>> import numpy as np
        >>> from securestate import BiasMonitor, Plant, Sensor
        >>> plant = Plant([[0.9]], [[0.1]], [Sensor(name, C=[1.0], R=1.0) for name in ("a", "b", "c")])
        >>> y = np.random.default_rng(1).normal(size=(200, 3))
        >>> y[50:, 1] += 1.5
        >>> run = BiasMonitor(plant).run(y)
        >>> print(run.suspected[-1], run.attack[-1].round(1), run.attack_std[-1, 1].round(1))
        [False  True False] [0.  1.7 0. ] 0.1
    """

    missing_limit = MISSING_LIMIT
    takes_covariance = False
    steady: SteadyState
    limit: float
    gamma: float

    def __init__(self, plant: Plant, *, run_length: float = 1000.0, calibrate_on: object = None) -> None:
        require_plant(plant)
        length = check.positive_number("run_length", run_length, InputError)
        if length < LEAST_RUN_LENGTH:
            raise InputError("run_length", f"at least {LEAST_RUN_LENGTH:g} samples", f"{run_length}")
        if plant.time_varying:
            raise DesignError(
                "the bias monitor needs a plant that does not vary in time",
                "use InnovationGate or InnovationMixture for A or C that change",
            )
        if plant.n_sensors < 2:
            raise DesignError(
                "the plant has a single sensor, and nobody can vouch for it",
                "add a sensor, or use KalmanFilter and trust the one there is",
            )
        if plant.uncheckable.all():
            warnings.warn(
                "no sensor is verifiable or protected, so that nobody can be named",
                SecurestateWarning,
                stacklevel=2,
            )
        self.steady = steady_state(plant)
        leads = design.ideal(plant, self.steady, design.simulated_samples(plant, length))
        self.limit = design.limit_of(leads, length)
        self.gamma = 1.0
        if calibrate_on is not None:
            self.gamma = design.variance_factor(plant, self.steady, leads, calibrate_on)
        kernel = design.kernel(plant, self.steady, self.limit, self.gamma)
        super().__init__(plant, kernel, {"run_length": length})

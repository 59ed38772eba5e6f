"""The direct way: injections become states of a Kalman filter, their increments white noise."""

from __future__ import annotations

from typing import final

from securestate._steady_state import SteadyState
from securestate.estimators._augmented import Augmented, PerSensor
from securestate.estimators.base import Estimator
from securestate.plant import Plant


@final
class AugmentedKalman(Estimator):
    """A Kalman filter whose state holds what is injected into the weak sensors, those not protected.

        X = [x; theta],   X[k|k] = X[k|k-1] + K (y[k] - [C, Phi] X[k|k-1] - D u[k])
        X[k+1|k] = diag(A, I) X[k|k] + [B; 0] u[k]

    theta has one entry per weak channel and is taken for a random walk whose increments have the covariance
    `attack_noise`. Channels may be missing one by one (NaN). A and C may vary in time.

    Args:
        plant: a plant with at least one protected and one weak sensor. Without a steady state, as when it
            varies in time, `run` and `start` need a prior with a covariance P.
        attack_noise: variance q of the increment of an injection from one sample to the next, in
            (sensor unit)^2 for every channel of the sensor: one number, one per weak sensor in the plant's
            order, or a mapping by sensor name. Small believes in lies that stay, large in lies that change.
        attack_start: the variance of an injection one sample before the first, in the same units and forms;
            None means that of `attack_noise`. With a prior that has a covariance, theta[0] before y[0] is
            0 with variance attack_start + attack_noise, independent of x[0].
        false_alarm_rate: probability that the model gives to a theta as far from its estimate as 0 is when a
            sensor is suspected, in (0, 1). An upper bound for honest sensors, whose theta stays 0: they raise
            alarms the more rarely the smaller attack_noise is.

    Attributes:
        steady: the steady state of the augmented filter, n + w states, or None.
        no_steady_state: why there is none; empty if there is one. attack_noise=0 has none.

    Raises:
        InputError: a setting is out of range.
        DesignError: no sensor is weak, or none protected; no sensor sees a mode that does not decay; no
            protected sensor sees a mode at eigenvalue 1, which a constant attack imitates. Names the mode.

    Notes:
        `Run.x`, `x_std` and `P` are those of the plant's n states. `Run.attack` is theta with `attack_std`;
        0 and 0 for a protected sensor, NaN where the channel is missing. `Run.innovation` is
        y - [C, Phi] X[k|k-1] - D u, with the expected injection taken off; `innovation_std` belongs to it.
        `Run.trust` of a weak sensor is 1 / (1 + d^2 / chi2), d^2 = theta' P_theta^-1 theta over its channels
        that arrived and chi2 the quantile 1 - false_alarm_rate for as many; it is `Run.suspected` where
        d^2 > chi2. That of a protected sensor is 1, NaN where nothing arrived. Successive estimates of
        theta are nearly the same number, so that alarms come in long rows.
        `Run.diagnostics`: as `KalmanFilter`, of the augmented system.
        ILL_CONDITIONED: as `KalmanFilter`.

    References:
        Chen, Weng, Ho, Yu 2022, Remark 3 and eq. (9) (docs/bibliography.md: chen2022).

    Examples:
        >>> from securestate import AugmentedKalman, Plant, Sensor
        >>> sensors = [Sensor("open", C=[1.0], R=1.0), Sensor("sealed", C=[1.0], R=1.0, protected=True)]
        >>> run = AugmentedKalman(Plant([[0.9]], [[1.0]], sensors)).run([[8.0, 0.0]] * 20)
        >>> print(run.x[-1].round(1), run.attack[-1].round(1), run.suspected[-1])
        [0.] [8. 0.] [ True False]
    """

    steady: SteadyState | None

    def __init__(
        self,
        plant: Plant,
        *,
        attack_noise: PerSensor = 1.0,
        attack_start: PerSensor | None = None,
        false_alarm_rate: float = 0.01,
    ) -> None:
        system = Augmented(plant, attack_noise, attack_start)
        self.steady, self.no_steady_state = system.steady, system.no_steady_state
        super().__init__(plant, system.kernel(false_alarm_rate), system.settings)

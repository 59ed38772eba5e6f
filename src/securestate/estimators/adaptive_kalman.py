"""Zhang's adaptive Kalman filter: the injections drift at a constant rate, estimated with forgetting."""

from __future__ import annotations

from typing import final

from securestate import _checks as check
from securestate._steady_state import SteadyState
from securestate.errors import InputError
from securestate.estimators._augmented import Augmented, PerSensor
from securestate.estimators.base import Estimator
from securestate.plant import Plant


@final
class AdaptiveKalman(Estimator):
    """A Kalman filter on state and injections that also estimates how the injections drift.

        X = [x; theta],   X[k+1] = diag(A, I) X[k] + [B; 0] u[k] + [0; I] phi + noise
        y = [C, Phi] X + D u + v
        phi[k] = phi[k-1] + Gamma[k] e[k],   X[k|k] = X[k|k-1] + K[k] e[k] + Upsilon[k] (phi[k] - phi[k-1])

    theta is what is injected into the channels of the weak sensors, those not protected. e is the innovation,
    K the gain of the Kalman filter with phi known; phi, the drift per sample, is taken for constant and found
    by recursive least squares with forgetting. Channels may be missing one by one (NaN). A and C may vary.

    Args:
        plant: a plant with at least one protected and one weak sensor. Without a steady state, as when it
            varies in time, `run` and `start` need a prior with a covariance P.
        forgetting: lambda in (0, 1]; the drift remembers about 1 / (1 - lambda) samples.
        attack_noise: variance of the noise on the increment of an injection, as in `AugmentedKalman`.
        attack_start: variance of an injection one sample before the first; theta[0] before y[0] is 0 with
            variance attack_start + attack_noise and the drift on top. It counts with a prior that has a P.
        drift_start: variance of the drift before the first sample, in (sensor unit per sample)^2, > 0, in the
            same forms.
        false_alarm_rate: as in `AugmentedKalman`, in (0, 1).

    Attributes:
        steady: the steady state of the augmented Kalman filter without drift, n + w states, or None.
        no_steady_state: why there is none; empty if there is one. attack_noise=0 has none.

    Raises:
        InputError: a setting is out of range.
        DesignError: as `AugmentedKalman`.

    Notes:
        `Run.P` is the upper left block of P + Upsilon S Upsilon', P the covariance of the Kalman filter that
        knows phi. It is the covariance of the error if the drift is constant and forgetting is 1; with
        forgetting below 1 it is an upper bound for a constant drift. For a drift that changes it says little.
        `Run.attack`, `attack_std`, `trust` and `suspected` come from theta and its part of the same matrix,
        as in `AugmentedKalman`. `Run.innovation` is y - [C, Phi] X[k|k-1] - D u with the drift in X[k|k-1];
        innovation_std, "log_likelihood" and "nis" take S / lambda for the uncertainty of the drift.
        The drift of a channel that did not arrive is not forgotten, so that S does not grow in silence.
        BROKEN_DOWN: S has grown beyond 1/eps of where it began, because nothing tells the drift any more, or
        a number overflowed. The sample shows the Kalman filter with drift 0, and the drift starts anew.
        ILL_CONDITIONED: as `KalmanFilter`.

    References:
        Zhang 2018, eqs (5a)-(5l) (docs/bibliography.md: zhang2018), on the system of Chen, Weng, Ho, Yu 2022,
        eq. (5) (chen2022).

    Examples:
        >>> from securestate import AdaptiveKalman, Plant, Sensor
        >>> sensors = [Sensor("open", C=[1.0], R=1.0), Sensor("sealed", C=[1.0], R=1.0, protected=True)]
        >>> ramp = [[0.5 * k, 0.0] for k in range(200)]
        >>> run = AdaptiveKalman(Plant([[0.9]], [[1.0]], sensors)).run(ramp)
        >>> print(run.attack[-1].round(1), run.suspected[-1])
        [99.5  0. ] [ True False]
    """

    steady: SteadyState | None

    def __init__(
        self,
        plant: Plant,
        *,
        forgetting: float = 0.95,
        attack_noise: PerSensor = 0.01,
        attack_start: PerSensor = 1.0,
        drift_start: PerSensor = 1.0,
        false_alarm_rate: float = 0.01,
    ) -> None:
        system = Augmented(plant, attack_noise, attack_start)
        factor = check.positive_number("forgetting", forgetting, InputError)
        if factor > 1:
            raise InputError("forgetting", "a number in (0, 1]", str(factor))
        drift = system.variances("drift_start", drift_start, positive=True)
        kernel = system.kernel(false_alarm_rate, (factor, drift))
        self.steady, self.no_steady_state = system.steady, system.no_steady_state
        super().__init__(plant, kernel, {"forgetting": factor} | system.settings)

"""The injections as states: the augmented plant, its settings, and the kernel on it.

    X = [x; theta],   X[k+1] = diag(A, I) X[k] + [B; 0] u + [w; phi],   y = [C, Phi] X + D u + v

theta has one entry per channel of a weak sensor, one that is not protected; Phi adds it to that channel. phi,
the increment of theta, is treated as white.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import final

import numpy as np
from numpy.typing import NDArray

from securestate import _checks as check
from securestate import _kernels
from securestate.errors import DesignError, InputError
from securestate.estimators._detectors import checked_rate, quantiles
from securestate.estimators._protected import warn_of_hidden_modes, warn_of_small
from securestate.estimators.kalman import prior_covariance, steady_or_reason
from securestate.plant import Plant
from securestate.resilience.detectability import mode_along, undetectable_modes

Float = NDArray[np.float64]

#: A variance for every weak sensor: one number, one per weak sensor in the plant's order, or by name.
PerSensor = float | Sequence[float] | Mapping[str, float]


@final
class Augmented:
    """A plant with its injections as states, and what can be said about them before any data.

    Args:
        plant: the plant.
        noise: variance of the increment of an injection per sample, (sensor unit)^2.
        start: variance of an injection before the first sample, on top of one increment, (sensor unit)^2;
            None means that of the increment.

    Attributes:
        weak: the channels that can be attacked, (w,).
        plant: the augmented plant, n + w states.
        steady: its filter's steady state, or None, and why there is none.
        prior: variance of theta[0] before y[0], normalised units, (w,).
        settings: the variances as they were understood.

    Raises:
        InputError: a variance is out of range.
        DesignError: nobody is weak or nobody is protected, or the two cannot be told apart.
    """

    def __init__(self, plant: Plant, noise: PerSensor, start: PerSensor | None) -> None:
        if not isinstance(plant, Plant):
            raise InputError("plant", "a Plant; Plant.load reads a file", type(plant).__name__)
        _refuse_one_kind(plant)
        self.weak = np.flatnonzero(~plant.protected[plant.channel_sensor])
        self.states = plant.n
        self._scale = plant.scale[self.weak] ** 2
        self._original = plant
        self.settings: dict[str, object] = {}
        increment = self.variances("attack_noise", noise)
        before = self.variances("attack_start", noise if start is None else start)
        self.prior = before + increment
        if not np.all(self.prior > 0):
            raise InputError(
                "attack_start", "a number > 0 where attack_noise is 0, or the injection stays 0", "0"
            )
        self.plant = augmented_plant(plant, self.weak, increment)
        if not plant.time_varying:
            _refuse_hidden(plant, self.plant)
            warn_of_hidden_modes(plant, stacklevel=4)
        size = np.maximum(increment, before)
        warn_of_small(plant, "attack_noise", self.weak, size, "give a larger one")
        self.steady, self.no_steady_state = steady_or_reason(self.plant)

    def variances(self, argument: str, value: PerSensor, *, positive: bool = False) -> Float:
        """A setting as one variance per weak channel, normalised units, (w,); noted in `settings`."""
        owners = self._original.channel_sensor[self.weak]
        names = [self._original.sensor_names[i] for i in np.unique(owners)]
        numbers = _per_sensor(argument, value, names, positive=positive)
        same = len(set(numbers)) == 1
        self.settings[argument] = numbers[0] if same else dict(zip(names, numbers, strict=True))
        each = dict(zip(np.unique(owners).tolist(), numbers, strict=True))
        return np.array([each[owner] for owner in owners.tolist()]) / self._scale

    def kernel(
        self, false_alarm_rate: float, forgetting: tuple[float, Float] | None = None
    ) -> _kernels.Kernel:
        """The kernel; `forgetting` is the factor and the variances of the drift, or None without a drift."""
        self.settings["false_alarm_rate"] = checked_rate(false_alarm_rate)
        return _kernels.augmented(
            self.plant,
            prior_covariance(self.steady),
            states=self.states,
            weak=self.weak.tolist(),
            start=self.prior,
            quantiles=quantiles(self.plant.m, false_alarm_rate),
            forgetting=forgetting,
        )


def augmented_plant(plant: Plant, weak: NDArray[np.int64], increment: Float) -> Plant:
    """The plant with one more state per weak channel, whose increments have these variances (w,)."""
    Phi = np.zeros((plant.m, len(weak)))
    Phi[weak, np.arange(len(weak))] = 1.0
    sensors = [
        sensor.replaced(C=_beside(sensor.C, Phi[plant.channels_of(i)]), R=None)
        for i, sensor in enumerate(plant.sensors)
    ]
    return Plant(
        _diagonal(plant.A, np.eye(len(weak))),
        _diagonal(plant.Q, np.diag(increment)),
        sensors,
        B=np.vstack([plant.B, np.zeros((len(weak), plant.n_inputs))]) if plant.n_inputs else None,
        D=plant.D if plant.n_inputs and all(sensor.D is None for sensor in plant.sensors) else None,
        R=plant.R,
        dt=plant.dt,
        state_names=[*plant.state_names, *(f"attack on {plant.channel_names[i]}" for i in weak)],
        input_names=plant.input_names or None,
        input_offset=plant.input_offset,
        input_scale=plant.input_scale,
        name=plant.name,
    )


def _diagonal(upper: Float, lower: Float) -> Float:
    """diag(upper, lower) for every sample of `upper`, (..., n, n)."""
    n, w = upper.shape[-1], len(lower)
    joint = np.zeros((*upper.shape[:-2], n + w, n + w))
    joint[..., :n, :n], joint[..., n:, n:] = upper, lower
    return joint


def _beside(C: Float, Phi: Float) -> Float:
    """[C, Phi] for every sample of C, (..., c, n + w)."""
    return np.concatenate([C, np.broadcast_to(Phi, (*C.shape[:-1], Phi.shape[-1]))], axis=-1)


def _per_sensor(argument: str, value: PerSensor, names: list[str], *, positive: bool) -> list[float]:
    """One variance per weak sensor."""
    if isinstance(value, Mapping):
        if set(value) != set(names):
            raise InputError(argument, f"the weak sensors {', '.join(names)}", ", ".join(map(str, value)))
        value = [value[name] for name in names]
    numbers = check.per_item(argument, value, len(names), "sensor that is not protected", InputError)
    allowed = numbers > 0 if positive else numbers >= 0
    if not np.all(allowed):
        bound = "> 0" if positive else ">= 0"
        raise InputError(argument, f"variances {bound}", str(numbers[~allowed][0]))
    return [float(number) for number in numbers]


def _refuse_one_kind(plant: Plant) -> None:
    if plant.protected.all():
        raise DesignError(
            "every sensor is protected, so that there is no attack to estimate", "use KalmanFilter"
        )
    if not plant.protected.any():
        raise DesignError(
            "no sensor is protected, so that nothing tells an attack from the state",
            "mark the sensors that nobody can tamper with as protected",
        )


def _refuse_hidden(plant: Plant, augmented: Plant) -> None:
    """Refuse a mode that no sensor sees, or one at 1 that an attack on the weak sensors can imitate.

    (diag(A, I), [C, Phi]) hides a mode at another eigenvalue than 1 if and only if (A, C) does; one at 1 if
    and only if the protected sensors do not see it.
    """
    for mode in undetectable_modes(plant):
        raise DesignError(
            f"no sensor sees {mode}, whose error does not decay", "add a sensor that depends on it"
        )
    for hidden in undetectable_modes(augmented):
        mode = mode_along(hidden.eigenvalue, hidden.direction[: plant.n], plant.state_names)
        raise DesignError(
            f"no protected sensor sees {mode}, so that a constant attack looks like it",
            "protect a sensor that depends on it",
        )

"""Design of joint fusion: who is stacked with whom, how large injections are assumed, what must hold.

Conditions for a plant that does not vary (docs/joint-fusion.md derives them):

1. A local estimator sees its augmented state [x; theta] if and only if (A, [C_i; C_s]) sees x and
   rank [I - A; C_s] = n. Modes that fade may stay unseen; others must not.
2. x can be told from any injection only if the protected sensors alone detect (A, C_s).
3. The gains are optimal one step ahead; their closed loop can be unstable all the same.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from securestate import _kernels
from securestate._checks import real_array
from securestate._steady_state import EDGE
from securestate.errors import DesignError, InputError, SecurestateWarning, ShapeError
from securestate.plant import Plant
from securestate.resilience.detectability import Mode, undetectable_modes

Float = NDArray[np.float64]

#: What pairs a sensor that may lie with protected ones, by name.
Pairing = Mapping[str, Sequence[str]]

#: Samples after which the gains count as those of the steady state when their closed loop is judged.
SETTLED = 400
#: Variance of an injection over that of the noise that stands for any size.
LARGE = 1e4


@dataclass(frozen=True)
class Local:
    """One local estimator: a sensor that may lie, stacked with protected ones (3).

    Attributes:
        sensor: index of the sensor that may lie.
        protected: indices of the protected sensors it is stacked with.
        weak_channels, protected_channels: the channels of both; rows of C_i in this order.
    """

    sensor: int
    protected: tuple[int, ...]
    weak_channels: tuple[int, ...]
    protected_channels: tuple[int, ...]

    @property
    def stack(self) -> tuple[list[int], list[int]]:
        """As kernels take it."""
        return list(self.weak_channels), list(self.protected_channels)


def everybody(plant: Plant) -> tuple[Local, ...]:
    """One local per sensor that may lie, stacked with all other sensors, for a protected set that changes.

    Raises:
        DesignError: every sensor is protected, or there is only one.
    """
    weak = np.flatnonzero(~plant.protected).tolist()
    if not weak:
        raise DesignError("every sensor is protected, so nobody can lie", "use KalmanFilter")
    if plant.n_sensors == 1:
        raise DesignError("one sensor has nobody to be stacked with", "use KalmanFilter")
    others = {sensor: [i for i in range(plant.n_sensors) if i != sensor] for sensor in weak}
    return tuple(_local(plant, sensor, tuple(others[sensor])) for sensor in weak)


def local_estimators(plant: Plant, pairing: Pairing | None) -> tuple[Local, ...]:
    """One per sensor that may lie, or per entry of `pairing`, in the plant's order.

    Raises:
        DesignError: no sensor is protected, or all are.
        InputError: a name in `pairing` is unknown or of the wrong kind.
    """
    if plant.protected.all():
        raise DesignError("every sensor is protected, so nobody can lie", "use KalmanFilter")
    if not plant.protected.any():
        raise DesignError(
            "joint fusion needs sensors that nobody can tamper with, and none is protected",
            "mark them as protected, or use a method that needs none",
        )
    everyone = tuple(np.flatnonzero(plant.protected).tolist())
    if pairing is None:
        pairs = {int(sensor): everyone for sensor in np.flatnonzero(~plant.protected)}
    else:
        pairs = _named(plant, pairing)
    return tuple(_local(plant, sensor, pairs[sensor]) for sensor in sorted(pairs))


def _named(plant: Plant, pairing: object) -> dict[int, tuple[int, ...]]:
    if not isinstance(pairing, Mapping) or not pairing:
        expected = "a mapping from sensor names to names of protected sensors"
        raise InputError("pairing", expected, repr(pairing))
    weak = {name: i for i, name in enumerate(plant.sensor_names) if not plant.protected[i]}
    strong = {name: i for i, name in enumerate(plant.sensor_names) if plant.protected[i]}
    pairs = {}
    for name, others in pairing.items():
        if name not in weak:
            raise InputError("pairing", f"sensors that are not protected ({', '.join(weak)})", repr(name))
        if not isinstance(others, str | list | tuple):
            raise InputError(f"pairing[{name!r}]", "a list of names of protected sensors", repr(others))
        partners = [others] if isinstance(others, str) else list(others)
        for partner in partners:
            if not isinstance(partner, str) or partner not in strong:
                expected = f"protected sensors ({', '.join(strong)})"
                raise InputError(f"pairing[{name!r}]", expected, repr(partner))
        if not partners or len(set(partners)) < len(partners):
            raise InputError(f"pairing[{name!r}]", "one or more different protected sensors", repr(partners))
        pairs[weak[name]] = tuple(sorted(strong[partner] for partner in partners))
    return pairs


def _local(plant: Plant, sensor: int, protected: tuple[int, ...]) -> Local:
    def channels(sensors: Sequence[int]) -> tuple[int, ...]:
        owned = [range(plant.m)[plant.channels_of(one)] for one in sensors]
        return tuple(channel for part in owned for channel in part)

    return Local(sensor, protected, channels([sensor]), channels(protected))


def injection_variances(plant: Plant, locals_: Sequence[Local], eta: Any) -> Float:
    """Eta of every channel that may lie, in the units of C x: (1, p) or (T, p) if it varies.

    Args:
        eta: in (sensor unit)^2: a number, a mapping by sensor name, one per local estimator (r,), or (T, r).

    Raises:
        InputError: not finite, negative, or a sensor without a value.
        ShapeError: an array of another shape.
    """
    r = len(locals_)
    names = [plant.sensor_names[local.sensor] for local in locals_]
    values = _by_name(names, eta) if isinstance(eta, Mapping) else real_array("eta", eta, InputError)
    if values.ndim == 0:
        values = np.full(r, values)
    if values.ndim not in (1, 2) or values.shape[-1] != r or 0 in values.shape:
        expected = f"a number, shape ({r},), one per sensor that may lie ({', '.join(names)}), or (T, {r})"
        raise ShapeError("eta", expected, f"shape {values.shape}")
    if not np.all(np.isfinite(values)) or np.any(values < 0):
        raise InputError("eta", "finite variances >= 0", f"{values[~(values >= 0) | np.isinf(values)][0]:g}")
    widths = [len(local.weak_channels) for local in locals_]
    scale = plant.scale[[channel for local in locals_ for channel in local.weak_channels]]
    return np.ascontiguousarray(np.repeat(np.atleast_2d(values), widths, axis=-1) / scale**2)


def large_injections(plant: Plant, locals_: Sequence[Local]) -> Float:
    """Variances that no noise reaches, (1, p): the closed loop of an adaptive eta is judged by them."""
    channels = [channel for local in locals_ for channel in local.weak_channels]
    return np.ascontiguousarray(LARGE * np.diag(plant.R)[np.newaxis, channels])


def _by_name(names: Sequence[str], eta: Mapping[str, Any]) -> Float:
    if sorted(map(str, eta)) != sorted(names):
        raise InputError("eta", f"a value for {', '.join(names)}", ", ".join(map(str, eta)) or "none")
    for name, value in eta.items():
        if isinstance(value, bool) or not isinstance(value, Real):
            raise InputError(f"eta[{name!r}]", "a number", repr(value))
    return np.array([float(eta[name]) for name in names])


def check_conditions(plant: Plant, locals_: Sequence[Local]) -> None:
    """Refuse what condition 1 excludes; warn of what condition 2 says. Nothing for a plant that varies.

    Raises:
        DesignError: naming the sensor and the mode.
    """
    if plant.time_varying:
        return
    for local in locals_:
        name = plant.sensor_names[local.sensor]
        for mode in undetectable_modes(plant.select([local.sensor, *local.protected])):
            raise DesignError(
                f"sensor {name!r} and the protected sensors it is stacked with do not see {mode}",
                "stack it with protected sensors that see this mode",
            )
        hidden = undetectable_modes(plant.select(local.protected))
        for mode in hidden:
            if abs(mode.eigenvalue - 1.0) <= EDGE:
                raise DesignError(
                    f"a constant injection on sensor {name!r} cannot be told from {mode}, "
                    "which the protected sensors it is stacked with do not see",
                    "protect a sensor that sees this mode",
                )
        if hidden:
            _warn(name, hidden[0])


def _warn(name: str, mode: Mode) -> None:
    warnings.warn(
        f"the protected sensors that sensor {name!r} is stacked with do not see {mode}: an injection along "
        "it stays invisible and moves the estimate without bound; protect a sensor that sees this mode",
        SecurestateWarning,
        stacklevel=5,
    )


def check_stability(plant: Plant, locals_: Sequence[Local], eta: Float, form: str, prior: Float) -> None:
    """Refuse a local estimator whose closed loop is unstable with its own gains, condition 3.

    Raises:
        DesignError: naming the sensor and the spectral radius.
    """
    start = 0
    for local in locals_:
        stop = start + len(local.weak_channels)
        radius = closed_loop_radius(plant, local, eta[:, start:stop], form, prior)
        start = stop
        if radius > 1.0 + EDGE:
            raise DesignError(
                f"the local estimator of sensor {plant.sensor_names[local.sensor]!r} is unstable: its gains "
                f"are optimal one step ahead, but its error grows by {radius:.6g} per sample",
                "stack it with protected sensors that see the growing modes, or use AdaptiveJointFilter",
            )


def closed_loop_radius(plant: Plant, local: Local, eta: Float, form: str, prior: Float) -> float:
    """Spectral radius of s(k-1) -> s(k), s = [x - xhat; -thetahat; phihat], with gains that have settled.

    Where eta is 0 both estimates of the injection stay 0, so they are left out.
    """
    moments = _kernels.joint_moments(
        plant,
        [local.stack],
        eta=np.ascontiguousarray(np.repeat(eta, SETTLED, axis=0)),
        form=form,
        fusion="optimal",
        prior=np.ascontiguousarray(prior),
        heard=np.ones((SETTLED, plant.m), dtype=np.bool_),
    )
    K, Gamma = moments["K"][0], moments["Gamma"][0]
    finite = np.isfinite(K).all(axis=(1, 2)) & np.isfinite(Gamma).all(axis=(1, 2)) & ~moments["broken"]
    last = int(np.flatnonzero(finite)[-1]) if finite.any() else 0
    n, p = plant.n, len(local.weak_channels)
    C = np.zeros((K.shape[-1], n + p))
    C[:, :n] = plant.C[[*local.weak_channels, *local.protected_channels]]
    C[:p, n:] = np.eye(p)
    T = np.block([[plant.A, np.zeros((n, 2 * p))], [np.zeros((p, n)), np.eye(p), -np.eye(p)]])
    closed = np.vstack([T - K[last] @ C @ T, Gamma[last] @ C @ T])
    closed[n + p :, n + p :] += np.eye(p)
    moves = np.concatenate([np.ones(n, dtype=np.bool_), np.tile(eta[0] > 0, 2)])
    return float(np.abs(np.linalg.eigvals(closed[np.ix_(moves, moves)])).max())


def as_mask(plant: Plant, steps: int, missing: ArrayLike | None) -> NDArray[np.bool_]:
    """Which channels arrive, (steps, m), from which are missing (m,) or (steps, m)."""
    if missing is None:
        return np.ones((steps, plant.m), dtype=np.bool_)
    given = np.asarray(missing)
    if given.dtype != np.bool_ or given.shape not in ((plant.m,), (steps, plant.m)):
        received = f"shape {given.shape} of {given.dtype}"
        raise ShapeError("missing", f"booleans of shape ({plant.m},) or ({steps}, {plant.m})", received)
    return np.ascontiguousarray(np.broadcast_to(~given, (steps, plant.m)))

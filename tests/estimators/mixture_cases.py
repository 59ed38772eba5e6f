"""Plants and data for the tests of the innovation mixture."""

from typing import Any

import numpy as np

from securestate import Belief, Plant, Run, Sensor
from securestate.estimators import Estimator

Array = np.ndarray[Any, np.dtype[np.float64]]


def random_plant(
    seed: int,
    n: int = 3,
    *,
    channels: tuple[int, ...] = (1, 2, 1, 3, 1, 2, 1),
    inputs: int = 2,
    **options: Any,
) -> Plant:
    """Sensors of one to three channels with units, noise correlated within a sensor, the last protected.

    Options: `varying`, samples over which A and C change; `protected`, names of the sensors.
    """
    rng = np.random.default_rng(seed)
    T, protected = options.get("varying"), options.get("protected", (f"s{len(channels) - 1}",))
    lead = () if T is None else (T,)
    A = rng.normal(size=(n, n))
    A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
    if T is not None:
        A = A + 0.1 * rng.normal(size=(T, n, n))
    root, sensors = rng.normal(size=(n, n)), []
    for i, m in enumerate(channels):
        noise = rng.normal(size=(m, m))
        C = rng.normal(size=(m, n)) + (0.3 * rng.normal(size=(*lead, m, n)) if lead else 0.0)
        sensors.append(
            Sensor(
                f"s{i}",
                C=C,
                R=noise @ noise.T + 0.3 * np.eye(m),
                D=rng.normal(size=(m, inputs)) if inputs else None,
                scale=rng.uniform(0.5, 2, m),
                offset=rng.normal(size=m),
                protected=f"s{i}" in protected,
            )
        )
    B = rng.normal(size=(n, inputs)) if inputs else None
    return Plant(A, 0.1 * root @ root.T + 0.1 * np.eye(n), sensors, B=B)


def some_prior(plant: Plant) -> Belief:
    root = np.random.default_rng(99).normal(size=(plant.n, plant.n))
    return Belief(np.arange(plant.n, dtype=float), root @ root.T + np.eye(plant.n))


def simulate(
    plant: Plant, T: int, rng: np.random.Generator, prior: Belief | None = None
) -> tuple[Array, ...]:
    """x (T, n), y (T, m) in file units and u (T, p), when nobody lies."""
    u, x, y = rng.normal(size=(T, plant.n_inputs)), np.empty((T, plant.n)), np.empty((T, plant.m))
    state = np.zeros(plant.n)
    if prior is not None:
        state = rng.multivariate_normal(prior.x, prior.P)
    noise = rng.multivariate_normal(np.zeros(plant.m), plant.R, size=T)
    drive = rng.multivariate_normal(np.zeros(plant.n), plant.Q, size=T)
    for k in range(T):
        A, C = (M[k] if M.ndim == 3 else M for M in (plant.A, plant.C))
        x[k], y[k] = state, C @ state + plant.D @ u[k] + noise[k]
        state = A @ state + plant.B @ u[k] + drive[k]
    return x, plant.denormalise(y), u


def attacked_data(
    plant: Plant, T: int, seed: int, *, share: float = 0.2, size: float = 6.0, missing: float = 0.0
) -> tuple[Array, Array]:
    """y and u; every sensor lies now and then, channels are missing, and once everything is."""
    rng = np.random.default_rng(seed)
    _, y, u = simulate(plant, T, rng)
    lies = (rng.random((T, plant.n_sensors)) < share)[:, plant.channel_sensor]
    y = y + lies * plant.scale * rng.normal(scale=size, size=y.shape)
    y[rng.random(y.shape) < missing] = np.nan
    if missing:
        y[T // 3] = np.nan
    return y, u


def heard(plant: Plant, y: Array) -> Array:
    """Of which sensors something arrived, (..., N)."""
    sent = ~np.isnan(y)
    return np.stack([sent[..., plant.channels_of(i)].any(axis=-1) for i in range(plant.n_sensors)], axis=-1)


def scalar_plant(N: int = 15, *, R: float = 1.0, **options: Any) -> Plant:
    return Plant([[0.9]], [[1.0]], [Sensor(f"s{i}", C=[1.0], R=R, **options) for i in range(N)])


def mean_square(run: Run, x: Array, after: int = 0) -> float:
    return float(((run.x - x)[..., after:, :] ** 2).sum(axis=-1).mean())


def steps(estimator: Estimator, y: Array, u: Array, prior: Belief | None) -> list[Any]:
    """Estimates of a live filter that is saved and resumed now and then."""
    live, estimates = estimator.start(prior), []
    for k, (now, given) in enumerate(zip(y, u, strict=True)):
        estimates.append(live.step(now, given))
        if k % 7 == 3:
            live = estimator.resume(live.save())
    return estimates

"""The classical detectors as in a textbook: S formed and inverted, one sensor after the other. Slow."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg as sl
from numpy.typing import NDArray
from scipy.stats import chi2

from securestate import Plant

Array = NDArray[np.float64]
#: Sample k, y, u and the predicted belief in, sensors left out as booleans (N,) out.
Rule = Callable[[int, Array, Array, Array, Array], NDArray[np.bool_]]


@dataclass
class Textbook:
    """Per sample: x (T, n), P (T, n, n), left_out (T, N), attack (T, m)."""

    x: Array
    P: Array
    left_out: NDArray[np.bool_]
    attack: Array


def detect(plant: Plant, rule: Rule, y: Array, u: Array, x: Array, P: Array) -> Textbook:
    """Kalman filter over y (T, m) from the belief x, P on; `rule` says who is left out."""
    rows: list[tuple[Any, ...]] = []
    for k, (yk, uk) in enumerate(zip(y, u, strict=True)):
        A, C = at(plant.A, k), at(plant.C, k)
        out = rule(k, yk, uk, x, P) & sent(plant, yk)
        lies = out[plant.channel_sensor]
        used = ~np.isnan(yk) & ~lies
        if used.any():
            S = C[used] @ P @ C[used].T + plant.R[np.ix_(used, used)]
            K = P @ C[used].T @ np.linalg.inv(S)
            x = x + K @ (yk - C @ x - plant.D @ uk)[used]
            F = np.eye(len(x)) - K @ C[used]
            P = F @ P @ F.T + K @ plant.R[np.ix_(used, used)] @ K.T
        rows.append((x, P, out, np.where(lies | np.isnan(yk), yk - C @ x - plant.D @ uk, 0.0)))
        x, P = A @ x + plant.B @ uk, A @ P @ A.T + plant.Q
    return Textbook(*(np.array(column) for column in zip(*rows, strict=True)))


def gate(plant: Plant, rate: float) -> Rule:
    """Every sensor against the fused prediction."""

    def rule(k: int, y: Array, u: Array, x: Array, P: Array) -> NDArray[np.bool_]:
        return ratios(plant, k, y, u, x, P, rate) > 1

    return rule


def central(plant: Plant, rate: float, *, worst: bool) -> Rule:
    """All channels at once; nothing is used, or the worst sensors are left out."""

    def rule(k: int, y: Array, u: Array, x: Array, P: Array) -> NDArray[np.bool_]:
        C = at(plant.C, k)
        residual, S = y - C @ x - plant.D @ u, C @ P @ C.T + plant.R

        def alarm(out: NDArray[np.bool_]) -> bool:
            used = ~np.isnan(y) & ~out[plant.channel_sensor]
            return ratio(residual[used], S[np.ix_(used, used)], rate) > 1

        out = np.zeros(plant.n_sensors, dtype=bool)
        if alarm(out) and not worst:
            return ~out
        size = ratios(plant, k, y, u, x, P, rate)
        for sensor in np.argsort(-size, kind="stable"):
            if not alarm(out):
                break
            out[sensor] = True
        return out

    return rule


def local(plant: Plant, rate: float, *, hold: bool, start: int = 0) -> Rule:
    """Every sensor against its own filter, which runs from zero; alarms count from sample `start` on."""
    filters = [Local(plant, sensor) for sensor in range(plant.n_sensors)]

    def rule(k: int, y: Array, u: Array, x: Array, P: Array) -> NDArray[np.bool_]:
        del x, P
        alarms = np.array([filter.step(y, u, rate, hold=hold) for filter in filters])
        return alarms & (k >= start)

    return rule


class Local:
    """The steady-state filter of one sensor on the whole state; needs a stable A, or (A, C_i) detectable."""

    def __init__(self, plant: Plant, sensor: int) -> None:
        self.plant, self.own = plant, plant.channels_of(sensor)
        C, R = plant.C[self.own], plant.R[self.own, self.own]
        P = sl.solve_discrete_are(plant.A.T, C.T, plant.Q, R)
        self.C, self.S = C, C @ P @ C.T + R
        self.K = P @ C.T @ np.linalg.inv(self.S)
        self.x = np.zeros(plant.n)

    def step(self, y: Array, u: Array, rate: float, *, hold: bool) -> bool:
        residual = y[self.own] - self.C @ self.x - self.plant.D[self.own] @ u
        arrived = ~np.isnan(residual)
        alarm = ratio(residual[arrived], self.S[np.ix_(arrived, arrived)], rate) > 1
        if arrived.all() and not (alarm and hold):
            self.x = self.x + self.K @ residual
        self.x = self.plant.A @ self.x + self.plant.B @ u
        return alarm


def ratios(plant: Plant, k: int, y: Array, u: Array, x: Array, P: Array, rate: float) -> Array:
    """Squared distance of every sensor from the prediction, over its quantile; 0 where nothing arrived."""
    C, size = at(plant.C, k), np.zeros(plant.n_sensors)
    residual, S = y - C @ x - plant.D @ u, C @ P @ C.T + plant.R
    for sensor in range(plant.n_sensors):
        own = ~np.isnan(y) & (plant.channel_sensor == sensor)
        size[sensor] = ratio(residual[own], S[np.ix_(own, own)], rate)
    return size


def ratio(residual: Array, S: Array, rate: float) -> float:
    if not residual.size:
        return 0.0
    return float(residual @ np.linalg.inv(S) @ residual / chi2.ppf(1 - rate, residual.size))


def sent(plant: Plant, y: Array) -> NDArray[np.bool_]:
    """Which sensors sent something, (N,)."""
    return np.array([not np.isnan(y[plant.channels_of(i)]).all() for i in range(plant.n_sensors)])


def at(M: Array, k: int) -> Array:
    return M[k] if M.ndim == 3 else M

"""The oracle: the Kalman filter that is told who lies. What any secure estimator can at best hope for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from securestate.errors import InputError, ShapeError
from securestate.estimators.base import Filter, check_inputs, check_measurements
from securestate.estimators.kalman import KalmanFilter
from securestate.estimators.run import Run
from securestate.plant import Belief, Plant

Float = NDArray[np.float64]
Bool = NDArray[np.bool_]


@final
class OracleFilter:
    """The Kalman filter that never hears an attacked sensor, because it is told who is attacked.

    A yardstick for the others. It is no `Estimator`, because it needs the truth at every sample.

    Args:
        plant: any plant that `KalmanFilter` takes.

    Attributes:
        plant: the plant.
        kalman: the Kalman filter that does the work.

    Notes:
        `Run.trust` is 0 for an attacked sensor, 1 for another one, NaN where it sent nothing. `Run.suspected`
        is `attacked` where the sensor sent something, `Run.attack` y - C x[k|k] - D u for attacked channels
        and 0 for the others. Diagnostics are those of `KalmanFilter`, of the channels in use.

    Examples:
        >>> from securestate import OracleFilter, Plant, Sensor
        >>> sensors = [Sensor(name, C=[1.0], R=1.0) for name in ("a", "b")]
        >>> run = OracleFilter(Plant([[0.9]], [[1.0]], sensors)).run([[0.0, 9.0]], attacked=[False, True])
        >>> print(run.x[0], run.attack[0])
        [0.] [0. 9.]
    """

    plant: Plant
    kalman: KalmanFilter

    def __init__(self, plant: Plant) -> None:
        self.kalman = KalmanFilter(plant)
        self.plant = plant

    def __repr__(self) -> str:
        return f"OracleFilter({self.plant!r})"

    def run(
        self,
        y: ArrayLike,
        u: ArrayLike | None = None,
        prior: Belief | None = None,
        *,
        attacked: ArrayLike,
        covariance: bool = True,
    ) -> Run:
        """Estimate a whole record, or a batch of records in parallel.

        Args:
            y, u, prior, covariance: as in `KalmanFilter.run`.
            attacked: True where a sensor is attacked, shape (N,) for all samples, (T, N), or (runs, T, N).
        Returns:
            Run; its arrays have the leading axes of `y`.
        Raises:
            InputError, ShapeError, MeasurementError: naming the argument, expected and received.
        """
        y = check_measurements(y, self.plant, ("runs", "T") if np.ndim(y) == 3 else ("T",))
        u = check_inputs(u, self.plant, y.shape)
        liars = _attacked(attacked, (*y.shape[:-1], self.plant.n_sensors))
        lies = liars[..., self.plant.channel_sensor]
        if isinstance(prior, str):  # who is told who lies needs nobody to find out
            raise InputError("prior", "a Belief or None", repr(prior))
        run = self.kalman.run(np.where(lies, np.nan, y), u, prior, covariance=covariance)
        start = np.zeros(self.plant.n) if prior is None else prior.x
        return _told(run, y, u, _predicted(self.plant, run.x, u, start), liars)

    def start(self, prior: Belief | None = None, *, runs: int | None = None) -> LiveOracle:
        """A live filter before its first measurement, or one per run; as in `Estimator.start`."""
        return LiveOracle(self, self.kalman.start(prior, runs=runs), prior)


@final
@dataclass(frozen=True)
class OracleEstimate:
    """Result of one step; the same fields as an `Estimate`."""

    x: Float
    x_std: Float
    P: Float
    trust: Float
    attack: Float
    attack_std: Float
    suspected: Bool
    innovation: Float
    innovation_std: Float
    status: int
    diagnostics: Mapping[str, float]


@final
class LiveOracle:
    """A live oracle, made by `OracleFilter.start`."""

    def __init__(self, oracle: OracleFilter, live: Filter, prior: Belief | None) -> None:
        self._oracle = oracle
        self._live = live
        self._predicted = np.zeros(oracle.plant.n) if prior is None else prior.x
        self._k = 0

    def run(
        self, y: ArrayLike, u: ArrayLike | None = None, *, attacked: ArrayLike, covariance: bool = True
    ) -> Run:
        """Continue over a block of samples; arguments, result and errors as for `OracleFilter.run`."""
        plant, first = self._oracle.plant, self._k
        y = check_measurements(y, plant, ("runs", "T") if np.ndim(y) == 3 else ("T",))
        u = check_inputs(u, plant, y.shape)
        liars = _attacked(attacked, (*y.shape[:-1], plant.n_sensors))
        heard = np.where(liars[..., plant.channel_sensor], np.nan, y)
        run = self._live.run(heard, u if plant.n_inputs else None, covariance=covariance)
        told = _told(run, y, u, _predicted(plant, run.x, u, self._predicted, first), liars, first)
        self._predicted = plant.successor(run.x[..., -1:, :], u[..., -1:, :], first + run.steps - 1)[
            ..., 0, :
        ]
        self._k += run.steps
        return told

    def step(self, y: ArrayLike, u: ArrayLike | None = None, *, attacked: ArrayLike) -> OracleEstimate:
        """Advance by one measurement y (m,) and input u (p,); `attacked` (N,) says who is attacked."""
        one = None if u is None else np.asarray(u)[np.newaxis]
        return _first(self.run(np.asarray(y)[np.newaxis], one, attacked=attacked))


def _first(run: Run) -> OracleEstimate:
    """The first sample of a run with covariances."""
    return OracleEstimate(
        x=run.x[0],
        x_std=run.x_std[0],
        P=np.empty((0, 0)) if run.P is None else run.P[0],
        trust=run.trust[0],
        attack=run.attack[0],
        attack_std=run.attack_std[0],
        suspected=run.suspected[0],
        innovation=run.innovation[0],
        innovation_std=run.innovation_std[0],
        status=int(run.status[0]),
        diagnostics={name: float(values[0]) for name, values in run.diagnostics.items()},
    )


def _attacked(value: ArrayLike, shape: tuple[int, ...]) -> Bool:
    """The attacked set for every sample, `shape` (..., T, N)."""
    given = np.asarray(value)
    if given.dtype != np.bool_:
        raise InputError("attacked", "an array of booleans", f"dtype {given.dtype}")
    allowed = [shape[i:] for i in reversed(range(len(shape)))]
    if given.shape not in allowed:
        raise ShapeError("attacked", " or ".join(f"shape {one}" for one in allowed), f"shape {given.shape}")
    return np.broadcast_to(given, shape)


def _told(run: Run, y: Float, u: Float, predicted: Float, liars: Bool, first: int = 0) -> Run:
    """The run of the Kalman filter with what it was not told about the attacked sensors."""
    plant = run.plant
    starts = np.searchsorted(plant.channel_sensor, np.arange(plant.n_sensors))
    sent = np.logical_or.reduceat(~np.isnan(y), starts, axis=-1)
    lies = liars[..., plant.channel_sensor]
    return replace(
        run,
        estimator="OracleFilter",
        trust=np.where(liars & sent, 0.0, run.trust),
        suspected=liars & sent,
        attack=np.where(lies | np.isnan(y), y - plant.reading(run.x, u, first), 0.0),
        innovation=np.where(lies, y - plant.reading(predicted, u, first), run.innovation),
    )


def _predicted(plant: Plant, x: Float, u: Float, start: Float, first: int = 0) -> Float:
    """x[k|k-1] of every sample from x[k|k] and the belief about the first one."""
    before = np.broadcast_to(start, (*x.shape[:-2], plant.n))[..., np.newaxis, :]
    if x.shape[-2] == 1:
        return before
    moved = plant.successor(x[..., :-1, :], u[..., :-1, :], first)
    return np.concatenate([before, moved], axis=-2)

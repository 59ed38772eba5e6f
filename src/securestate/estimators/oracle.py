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
        run = self.kalman.run(np.where(lies, np.nan, y), u, prior, covariance=covariance)
        start = np.zeros(self.plant.n) if prior is None else prior.x
        return _told(self.plant, run, y, u, _predicted(self.plant, run.x, u, start), liars)

    def start(self, prior: Belief | None = None) -> LiveOracle:
        """A live filter before its first measurement; `prior` None means mean zero and steady state."""
        return LiveOracle(self, self.kalman.start(prior), prior)


@final
@dataclass(frozen=True)
class OracleEstimate:
    """Result of one step; the same fields as an `Estimate`."""

    x: Float
    x_std: Float
    P: Float
    trust: Float
    attack: Float
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

    def step(self, y: ArrayLike, u: ArrayLike | None = None, *, attacked: ArrayLike) -> OracleEstimate:
        """Advance by one measurement y (m,) and input u (p,); `attacked` (N,) says who is attacked."""
        plant = self._oracle.plant
        y = check_measurements(np.asarray(y)[np.newaxis], plant, ("T",))
        u = check_inputs(None if u is None else np.asarray(u)[np.newaxis], plant, y.shape)
        liars = _attacked(attacked, (1, plant.n_sensors))
        run = self._live.run(np.where(liars[:, plant.channel_sensor], np.nan, y), u)
        run = _told(plant, run, y, u, self._predicted[np.newaxis], liars, first=self._k)
        self._predicted = _moved(plant, run.x, u, first=self._k)[0]
        self._k += 1
        return _first(run)


def _first(run: Run) -> OracleEstimate:
    """The first sample of a run with covariances."""
    return OracleEstimate(
        x=run.x[0],
        x_std=run.x_std[0],
        P=np.empty((0, 0)) if run.P is None else run.P[0],
        trust=run.trust[0],
        attack=run.attack[0],
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


def _told(
    plant: Plant, run: Run, y: Float, u: Float, predicted: Float, liars: Bool, *, first: int = 0
) -> Run:
    """The run of the Kalman filter with what it was not told about the attacked sensors."""
    starts = np.searchsorted(plant.channel_sensor, np.arange(plant.n_sensors))
    sent = np.logical_or.reduceat(~np.isnan(y), starts, axis=-1)
    lies = liars[..., plant.channel_sensor]
    surprise, injected = (_residual(plant, x, y, u, first) for x in (predicted, run.x))
    return replace(
        run,
        estimator="OracleFilter",
        trust=np.where(sent, np.where(liars, 0.0, 1.0), np.nan),
        suspected=liars & sent,
        attack=np.where(lies | np.isnan(y), injected, 0.0),
        innovation=np.where(lies, surprise, run.innovation),
    )


def _residual(plant: Plant, x: Float, y: Float, u: Float, first: int) -> Float:
    """What is left of y when C x + D u is taken away, in sensor units, NaN where y is."""
    C = plant.C[first : first + y.shape[-2]] if plant.C.ndim == 3 else plant.C
    expected = np.einsum("...ij,...j->...i", C, x) + plant.normalise_input(u) @ plant.D.T
    return y - plant.denormalise(expected)


def _moved(plant: Plant, x: Float, u: Float, first: int = 0) -> Float:
    """The prediction A x + B u from every sample."""
    A = plant.A[first : first + x.shape[-2]] if plant.A.ndim == 3 else plant.A
    moved: Float = np.einsum("...ij,...j->...i", A, x) + plant.normalise_input(u) @ plant.B.T
    return moved


def _predicted(plant: Plant, x: Float, u: Float, start: Float) -> Float:
    """x[k|k-1] of every sample from x[k|k] and the prior mean."""
    moved = _moved(plant, x, u)
    before = np.broadcast_to(start, (*x.shape[:-2], 1, plant.n))
    return np.concatenate([before, moved[..., :-1, :]], axis=-2)

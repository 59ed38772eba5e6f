"""The result of running an estimator over a record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from securestate.errors import InputError, ShapeError
from securestate.plant import Plant

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

Float = NDArray[np.float64]

#: The arrays of a run and the name of their last axis.
_AXES = {
    "x": "state",
    "x_std": "state",
    "trust": "sensor",
    "suspected": "sensor",
    "attack": "channel",
    "attack_std": "channel",
    "innovation": "channel",
    "innovation_std": "channel",
}


@dataclass(frozen=True, eq=False, kw_only=True)
class Run:
    """Estimates for every sample. Leading axes (T,) for one run, (runs, T) for a batch.

    Attributes:
        plant: the plant the estimator was designed for.
        estimator: name of the method.
        settings: its choices, as plain values.
        x: filtered state x[k|k], (..., T, n).
        x_std: its standard deviations, (..., T, n).
        P: its covariance, (..., T, n, n), or None when it was not asked for.
        trust: per sensor in [0, 1], (..., T, N); NaN where the sensor sent nothing, and where one that cannot
            be checked (`Plant.uncheckable`) is not suspected.
        attack: estimated injection in sensor units, NaN where the method has no estimate, (..., T, m).
        attack_std: standard deviation of its error, NaN where the method states none, (..., T, m).
        suspected: whether a sensor is suspected, (..., T, N).
        innovation: y − C x[k|k−1] − D u in sensor units, NaN where missing, (..., T, m).
        innovation_std: its standard deviation when nobody lies, (..., T, m).
        status: numbers of `Status`, (..., T).
        diagnostics: numbers about the method itself, each (..., T).
        time: seconds or datetime64 per sample, (T,), or None.
    """

    plant: Plant
    estimator: str
    settings: Mapping[str, object]
    x: Float
    x_std: Float
    P: Float | None
    trust: Float
    attack: Float
    attack_std: Float
    suspected: NDArray[np.bool_]
    innovation: Float
    innovation_std: Float
    status: NDArray[np.uint8]
    diagnostics: Mapping[str, Float]
    time: NDArray[Any] | None = None

    @property
    def steps(self) -> int:
        """T, samples per run."""
        return int(self.x.shape[-2])

    @property
    def runs(self) -> int | None:
        """Number of runs of a batch, None for a single run."""
        return self.x.shape[0] if self.x.ndim == 3 else None

    def __repr__(self) -> str:
        runs = "" if self.runs is None else f"{self.runs} runs × "
        return f"Run({self.estimator}, {runs}{self.steps} samples of {self.plant!r})"

    def with_time(self, time: NDArray[Any] | None) -> Run:
        """The same run with the time of each sample, shape (T,): seconds or datetime64."""
        if time is not None and time.shape != (self.steps,):
            raise ShapeError("time", f"shape ({self.steps},)", f"shape {time.shape}")
        return replace(self, time=time)

    @staticmethod
    def concat(blocks: Sequence[Run]) -> Run:
        """Join successive blocks of one filter in time."""
        if not blocks:
            raise InputError("blocks", "at least one run", "none")
        first = blocks[0]
        if len(blocks) == 1:
            return first
        axis = first.status.ndim - 1

        def join(name: str) -> NDArray[Any]:
            return np.concatenate([getattr(block, name) for block in blocks], axis=axis)

        arrays: dict[str, Any] = {name: join(name) for name in (*_AXES, "status")}
        return replace(
            first,
            **arrays,
            P=None if any(block.P is None for block in blocks) else join("P"),
            diagnostics={
                name: np.concatenate([block.diagnostics[name] for block in blocks], axis=axis)
                for name in first.diagnostics
            },
            time=None if any(block.time is None for block in blocks) else join("time"),
        )

    def to_xarray(self) -> xr.Dataset:
        """Labelled arrays with dimensions run (for a batch), time, state, sensor and channel."""
        import xarray as xr

        lead = ("time",) if self.runs is None else ("run", "time")
        data: dict[str, Any] = {name: ((*lead, axis), getattr(self, name)) for name, axis in _AXES.items()}
        data["status"] = (lead, self.status)
        data |= {name: (lead, values) for name, values in self.diagnostics.items()}
        if self.P is not None:
            data["P"] = ((*lead, "state", "state_2"), self.P)
        coords: dict[str, Any] = {
            "time": self._time(),
            "state": list(self.plant.state_names),
            "sensor": list(self.plant.sensor_names),
            "channel": list(self.plant.channel_names),
        }
        attributes = {"estimator": self.estimator, "plant": self.plant.name}
        return xr.Dataset(data, coords, attributes)

    def to_pandas(self) -> pd.DataFrame:
        """One row per sample, columns such as ``x.<state>``, ``trust.<sensor>`` and ``attack.<channel>``.

        A batch has a two-level index (run, time).
        """
        import pandas as pd

        columns: dict[str, NDArray[Any]] = {}
        names = {
            "state": self.plant.state_names,
            "sensor": self.plant.sensor_names,
            "channel": self.plant.channel_names,
        }
        for quantity, axis in _AXES.items():
            values = getattr(self, quantity).reshape(-1, len(names[axis]))
            columns |= {f"{quantity}.{name}": values[:, i] for i, name in enumerate(names[axis])}
        columns["status"] = self.status.reshape(-1)
        columns |= {name: values.reshape(-1) for name, values in self.diagnostics.items()}
        return pd.DataFrame(columns, index=self._index())

    def plot(self) -> Any:
        """An overview as a plotly figure: trust of every sensor and worst normalised innovation over time."""
        from securestate.estimators._overview import overview

        return overview(self, self._time())

    def _time(self) -> NDArray[Any]:
        return self.plant.dt * np.arange(self.steps) if self.time is None else self.time

    def _index(self) -> pd.Index[Any]:
        import pandas as pd

        index: pd.Index[Any] = pd.Index(self._time(), name="time")
        if self.runs is not None:
            index = pd.MultiIndex.from_product([range(self.runs), index], names=["run", "time"])
        return index

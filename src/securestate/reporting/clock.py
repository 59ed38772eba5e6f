"""Times of a run as a reader wants them: ISO dates, seconds, minutes, hours, days, or sample numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from securestate.estimators.run import Run

UNITS = (("d", 86400.0, 14 * 86400.0), ("h", 3600.0, 3 * 3600.0), ("min", 60.0, 600.0), ("s", 1.0, 0.0))
"""Unit, its seconds, and the shortest span in seconds it is used for."""


@dataclass(frozen=True)
class Moment:
    """One sample of a run: its index, and its time if the run has times (seconds or datetime64)."""

    index: int
    time: float | np.datetime64 | None

    @classmethod
    def of(cls, run: Run, index: int) -> Moment:
        """The moment of a sample."""
        return cls(int(index), None if run.time is None else run.time[index])


@dataclass(frozen=True)
class Clock:
    """The time of every sample. `values` (T,) are in `unit`; for unit "date" milliseconds since 1970."""

    unit: str
    values: NDArray[np.float64]

    @classmethod
    def of(cls, run: Run) -> Clock:
        """The clock of a run; without times it counts sample times, or samples if the sample time is 1."""
        if run.time is None:
            index = np.arange(run.x.shape[0], dtype=np.float64)
            return cls("sample", index) if run.plant.dt == 1.0 else _in_best_unit(index * run.plant.dt)
        if np.issubdtype(run.time.dtype, np.datetime64):
            return cls("date", run.time.astype("datetime64[us]").astype(np.int64) / 1000.0)
        return _in_best_unit(run.time.astype(np.float64))

    @property
    def regular(self) -> tuple[float, float] | None:
        """Start and step if all steps are equal, else None."""
        steps = np.diff(self.values)
        if steps.size == 0:
            return float(self.values[0]), 1.0
        step = float((self.values[-1] - self.values[0]) / steps.size)
        return (float(self.values[0]), step) if np.abs(steps - step).max() <= 1e-6 * abs(step) else None

    def text(self, index: int) -> str:
        """The time of one sample, with its unit."""
        value = self.values[index]
        if self.unit == "date":
            moment = np.datetime64(round(float(value)), "ms")
            whole = np.all(self.values % 60000 == 0)
            return str(np.datetime_as_string(moment, unit="m" if whole else "s")).replace("T", " ")
        return f"sample {index}" if self.unit == "sample" else f"{value:.{self.decimals}f} {self.unit}"

    def moment(self, index: int) -> str:
        """The time of one sample and its number; the same words where samples are the time."""
        return self.text(index) if self.unit == "sample" else f"{self.text(index)} (sample {index})"

    @property
    def decimals(self) -> int:
        """Decimals that tell one sample from the next."""
        steps = np.diff(self.values)
        step = float(np.median(steps)) if steps.size else 1.0
        return min(9, max(0, math.ceil(-math.log10(step)))) if step > 0 else 9

    @property
    def span(self) -> str:
        """From the first sample to the last."""
        return f"{self.text(0)} to {self.text(-1 % self.values.size)}"


def _in_best_unit(seconds: NDArray[np.float64]) -> Clock:
    span = float(seconds[-1] - seconds[0])
    unit, length, _ = next(u for u in UNITS if span >= u[2])
    return Clock(unit, seconds / length)

"""What every estimator offers: run a record, start a live filter, save it, resume it.

An estimator is an immutable value made at design time. Its kernel does the work per sample; the classes here
check shapes, hand arrays over and give the results their names.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from enum import IntEnum
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from securestate import _kernels
from securestate._checks import whole_number
from securestate.errors import InputError, SecurestateWarning, ShapeError
from securestate.estimators.run import Run
from securestate.plant import Belief, Plant

Float = NDArray[np.float64]


class Status(IntEnum):
    """How a step went. Numbers in `Run.status` and `Estimate.status`."""

    OK = 0
    NO_MEASUREMENT = 1
    NOT_CONVERGED = 2
    ILL_CONDITIONED = 3
    BROKEN_DOWN = 4
    AMBIGUOUS = 5
    MAJORITY_SUSPECT = 6
    COLD_START = 7

    @property
    def advice(self) -> str:
        """What the numbers mean and what to do."""
        return _ADVICE[self]


_ADVICE = {
    Status.OK: "The numbers mean what they say.",
    Status.NO_MEASUREMENT: (
        "No channel arrived or all were left out, so the estimate is a prediction. Check the connection."
    ),
    Status.NOT_CONVERGED: "The solver stopped at its cap; diagnostic 'gap' says how far it is from the end.",
    Status.ILL_CONDITIONED: "The sensors that are left do not determine the state; the estimate is a guess.",
    Status.BROKEN_DOWN: (
        "The method's own recursion broke down; this sample shows the safer filter that its page names."
    ),
    Status.AMBIGUOUS: (
        "Two ways to say who lies explain the sample about equally well; not every method's P includes both."
    ),
    Status.MAJORITY_SUSPECT: (
        "More than half of the sensors are suspected: those that are believed may be the liars."
    ),
    Status.COLD_START: (
        "No prior was given; the estimate is that of the window of the first samples, later ones included."
    ),
}


class Filter(_kernels.Filter):
    """A live filter: an estimator with a state. Made by `Estimator.start` and `Estimator.resume`.

    `step(y, u=None)` takes one measurement of shape (m,) in sensor units, NaN marking a missing channel, and
    returns an `Estimate`. `save()` returns bytes from which `Estimator.resume` continues bit for bit.

    A filter started for several runs has a state for each; it only runs blocks.
    """

    _estimator: Estimator
    _runs: int | None

    def __new__(
        cls,
        estimator: Estimator,
        means: Float | None,
        covariance: Float | None,
        blob: bytes | None,
        runs: int | None = None,
    ) -> Filter:
        """Called by `Estimator`; use `Estimator.start` or `Estimator.resume`."""
        self = super().__new__(cls, estimator.kernel, means, covariance, blob)
        self._estimator = estimator
        self._runs = runs
        return self

    def run(self, y: ArrayLike, u: ArrayLike | None = None, *, covariance: bool = True) -> Run:
        """Continue this filter over a block of samples.

        Args:
            y: measurements, shape (T, m), or (runs, T, m) if started for several runs, sensor units; NaN
                marks a missing channel.
            u: inputs, shape (T, p) or, for several runs, also (runs, T, p), file units; needed if and only
                if the plant has inputs.
            covariance: False leaves `Run.P` None, which saves n² numbers per sample.
        Returns:
            Run; its arrays have the leading axes of `y`.
        Raises:
            ShapeError, MeasurementError: naming the argument, expected and received.
        """
        plant, batch = self._estimator.plant, self._runs is not None
        y = check_measurements(y, plant, ("runs", "T") if batch else ("T",))
        if batch and len(y) != self._runs:
            raise ShapeError("y", f"{self._runs} runs, as many as were started", f"{len(y)}")
        u = check_inputs(u, plant, y.shape)
        y = y if batch else y[np.newaxis]
        return _advance(self, self._estimator, y, u, covariance=covariance, batch=batch)

    def run_against(
        self, clean: Float, opened: Float, gain: Float, u: Float, mean: Float, *, covariance: bool = True
    ) -> tuple[Run, Float]:
        """Run against adversaries that answer in proportion to what this filter expects.

            y[k] = opened[k] + gain[k] (clean[k] - expected[k])

        Args:
            clean: what the sensors measure, (runs, T, m), sensor units.
            opened: the same with all other injections; NaN marks a missing channel.
            gain: (runs, T, m), zero where nobody reacts.
            u: inputs, (runs, T, p), file units.
            mean: x[0|-1], (n,), from which this filter was started.
        Returns:
            The run, a batch, and y (runs, T, m).
        """
        plant = self._estimator.plant
        means = np.ascontiguousarray(np.broadcast_to(mean, (len(clean), plant.n)))
        arrays, y = self.react(clean, opened, gain, u, means, plant, covariance)
        _warn_of_missing(self._estimator, y)
        return _run(self._estimator, arrays), y


class Estimator:
    """Base of all estimators; subclasses only design a kernel.

    Attributes:
        plant: the plant it was designed for.
        settings: the choices made, as plain values.
    """

    plant: Plant
    settings: Mapping[str, object]
    kernel: _kernels.Kernel
    #: Why `run` and `start` need a prior with a covariance P; empty if they do not.
    no_steady_state: str = ""
    #: Whether a prior may say P; False: the method always has the covariance of its steady state.
    takes_covariance: bool = True
    #: Another estimator of the same plant whose result belongs beside this one's, or None.
    beside: Estimator | None = None
    #: Share of missing samples above which `run` warns that the method is the wrong tool; None = never.
    missing_limit: float | None = None

    def __init__(self, plant: Plant, kernel: _kernels.Kernel, settings: Mapping[str, object]) -> None:
        self.plant = plant
        self.kernel = kernel
        self.settings = dict(settings)

    @property
    def name(self) -> str:
        """Name of the method."""
        return type(self).__name__

    def __repr__(self) -> str:
        settings = ", ".join(f"{key}={value!r}" for key, value in self.settings.items())
        return f"{self.name}({self.plant!r}{', ' if settings else ''}{settings})"

    def run(
        self,
        y: ArrayLike,
        u: ArrayLike | None = None,
        prior: Belief | Literal["window"] | None = None,
        *,
        covariance: bool = True,
    ) -> Run:
        """Estimate a whole record, or a batch of records in parallel.

        Args:
            y: measurements, shape (T, m) or (runs, T, m), sensor units; NaN marks a missing channel. A table
                with column names, such as a DataFrame, is read by the names of the channels.
            u: inputs, shape (T, p), or (runs, T, p) for a batch; needed if and only if the plant has inputs.
            prior: belief about x[0] before y[0]; None means mean zero and steady state. "window" needs none:
                `cold_start` estimates the first samples, as many as it takes, each run for itself, and the
                estimator starts from its belief. The states of these samples are smoothed, their status is
                COLD_START or, with a warning, ILL_CONDITIONED, their innovations are NaN.
            covariance: False leaves `Run.P` None, which saves n² numbers per sample.
        Returns:
            Run; its arrays have the leading axes of `y`. A batch gives the same bits as a loop.
        Raises:
            ShapeError, MeasurementError: naming the argument, expected and received.
            DesignError: for "window", no sensor sees some mode of the plant.
        """
        batch = np.ndim(y) == 3
        y = check_measurements(y, self.plant, ("runs", "T") if batch else ("T",))
        u = check_inputs(u, self.plant, y.shape)
        if isinstance(prior, str) and prior == "window":
            from securestate.estimators.window_run import run_from_window  # it is built on this module

            return run_from_window(self, y, u, covariance=covariance)
        bank = self.start(prior, runs=y.shape[0] if batch else None)
        return _advance(bank, self, y if batch else y[np.newaxis], u, covariance=covariance, batch=batch)

    def start(self, prior: Belief | None = None, *, runs: int | None = None) -> Filter:
        """A live filter before its first measurement; `prior` None means mean zero and steady state.

        With `runs` it holds that many independent filters, which advance in parallel by `Filter.run`.
        """
        mean, cov = self._prior(prior)
        if runs is not None:
            whole_number("runs", runs, 1, InputError)
        means = np.ascontiguousarray(np.broadcast_to(mean, (runs or 1, self.plant.n)))
        return Filter(self, means, cov, None, runs)

    def from_sample(self, first: int) -> Estimator:
        """The same method and settings for the plant counted from sample `first` on.

        Itself if nothing varies in time.
        """
        settings = self._settings_from(first)
        if settings is self.settings and not self.plant.time_varying:
            return self
        design: Any = type(self)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SecurestateWarning)  # said when this one was designed
            later: Estimator = design(self.plant.from_sample(first), **settings)
        return later

    def resume(self, blob: bytes) -> Filter:
        """The filter whose `save()` returned `blob`; it continues bit for bit.

        Raises:
            ResumeError: the bytes are damaged, or come from another estimator or plant.
        """
        return Filter(self, None, None, blob)

    def _settings_from(self, _first: int) -> Mapping[str, Any]:
        """The settings counted from sample `first` on; a method whose settings vary in time cuts them."""
        return self.settings

    def _prior(self, prior: object) -> tuple[Float, Float | None]:
        if prior is None:
            return np.zeros(self.plant.n), None
        if isinstance(prior, str) and prior == "window":
            expected = "a Belief or None; collect samples, call cold_start(plant, y), start from its belief"
            raise InputError("prior", expected, '"window"')
        if not isinstance(prior, Belief):
            given = repr(prior) if isinstance(prior, str) else type(prior).__name__
            raise InputError("prior", 'a Belief, None, or "window" in run', given)
        if prior.x.shape != (self.plant.n,):
            raise ShapeError("prior.x", f"shape ({self.plant.n},)", f"shape {prior.x.shape}")
        return np.ascontiguousarray(prior.x), None if prior.P is None else np.ascontiguousarray(prior.P)


def check_measurements(y: ArrayLike, plant: Plant, axes: tuple[str, ...]) -> Float:
    """Measurements as a contiguous float array of shape (*axes, m)."""
    y = _floats("y", _in_order("y", y, plant.channel_names))
    if y.ndim != len(axes) + 1 or y.shape[-1] != plant.m or 0 in y.shape:
        expected = f"shape ({', '.join(axes)}, {plant.m})" + (" or (runs, T, m)" if len(axes) == 1 else "")
        raise ShapeError("y", expected, f"shape {y.shape}")
    return y


def check_inputs(u: ArrayLike | None, plant: Plant, y_shape: tuple[int, ...]) -> Float:
    """Inputs as a contiguous float array of shape (T, p) or (runs, T, p)."""
    steps, p = y_shape[-2], plant.n_inputs
    if u is None:
        if p:
            raise ShapeError("u", f"shape ({steps}, {p}), because the plant has inputs", "None")
        return np.zeros((steps, 0))
    u = _floats("u", _in_order("u", u, plant.input_names))
    if u.shape not in ((steps, p), (*y_shape[:-1], p)):
        raise ShapeError("u", f"shape {(steps, p)}", f"shape {u.shape}")
    return u


def _in_order(name: str, values: ArrayLike, names: tuple[str, ...]) -> ArrayLike:
    """The columns of a table with column names, such as a DataFrame, in the plant's order; others as is."""
    table: Any = values
    if not hasattr(table, "columns") or not hasattr(table, "to_numpy"):
        return values
    columns = [str(column) for column in table.columns]
    if sorted(columns) != sorted(names):
        raise InputError(name, f"the columns {', '.join(names)}", ", ".join(columns))
    return np.asarray(table[list(names)].to_numpy())


def _floats(name: str, values: ArrayLike) -> Float:
    try:
        array = np.asarray(values)
        if array.dtype.kind not in "fiub":
            raise TypeError(f"dtype {array.dtype}")
        return np.ascontiguousarray(array, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(name, "an array of real numbers", str(error)) from error


def _advance(bank: Filter, estimator: Estimator, y: Float, u: Float, *, covariance: bool, batch: bool) -> Run:
    """Run the kernel and name what it returns."""
    _warn_of_missing(estimator, y)
    arrays: dict[str, Any] = bank.advance(y, u, y.shape[1], covariance)
    if not batch:
        arrays = {name: array[0] for name, array in arrays.items()}
    return _run(estimator, arrays)


def _warn_of_missing(estimator: Estimator, y: Float) -> None:
    missing = float(np.isnan(y).mean())
    if estimator.missing_limit is not None and missing > estimator.missing_limit:
        message = f"{missing:.0%} of the samples are missing; {estimator.name} is a steady-state filter"
        warnings.warn(
            f"{message}, use one that varies in time (KalmanFilter)", SecurestateWarning, stacklevel=4
        )


def _run(estimator: Estimator, arrays: dict[str, Any]) -> Run:
    """Name the arrays of a kernel."""
    numbers = arrays.pop("diagnostics")
    names = estimator.kernel.diagnostics
    return Run(
        plant=estimator.plant,
        estimator=estimator.name,
        settings=estimator.settings,
        suspected=arrays.pop("suspected").astype(bool),
        P=arrays.pop("P", None),
        diagnostics={name: np.ascontiguousarray(numbers[..., i]) for i, name in enumerate(names)},
        **arrays,
    )

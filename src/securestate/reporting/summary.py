"""What a run says, in numbers: how often and since when each sensor was suspected, how the solver fared."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from securestate._words import count, enumerate_names
from securestate.errors import InputError
from securestate.estimators.base import Status

if TYPE_CHECKING:
    from securestate.estimators.run import Run

WINDOW = 20
"""A sensor lies if half of some WINDOW samples it sent in a row were suspected; fewer are isolated alarms."""


BY_PROTECTED = ("AdaptiveJointFilter", "AdaptiveKalman", "AugmentedKalman", "JointFusion", "ProtectedKalman")
"""Estimators in which protected sensors judge the others, so that a majority of these may lie."""


@dataclass(frozen=True)
class Moment:
    """One sample of a run: its index, and its time if the run has times (seconds or datetime64)."""

    index: int
    time: float | np.datetime64 | None


@dataclass(frozen=True)
class Injection:
    """What a suspected sensor adds to one channel, in file units; NaN if the estimator gives no estimate.

    `median` is taken while suspected; `spread` is a standard deviation, from the median absolute deviation.
    """

    channel: str
    unit: str
    median: float
    spread: float


@dataclass(frozen=True)
class SensorSummary:
    """One sensor over a whole run. Shares are of all samples of the run, in [0, 1].

    `lies` tells a sensor that was suspected persistently from one with isolated alarms: at least half of
    some 20 samples in a row (of those it sent) were suspected. `since` is where that stretch begins.
    `uncheckable`: it may lie and no other sensor can vouch for it, so that no alarm is no evidence.
    """

    name: str
    protected: bool
    uncheckable: bool
    suspected: float
    missing: float
    first_alarm: Moment | None
    lies: bool
    since: Moment | None
    injections: tuple[Injection, ...]


@dataclass(frozen=True)
class StatusCount:
    """How many samples ended with one status, and what to do about it."""

    name: str
    count: int
    advice: str


@dataclass(frozen=True)
class Summary:
    """What one run says. `fast_path`, `iterations` and `gap` are None where the estimator has no such figure.

    `fast_path` is a share of samples; `iterations` the median over the samples off it; `gap` the worst one.
    """

    plant: str
    estimator: str
    samples: int
    sensors: tuple[SensorSummary, ...]
    statuses: tuple[StatusCount, ...]
    fast_path: float | None
    iterations: float | None
    gap: float | None

    @property
    def liars(self) -> tuple[str, ...]:
        """Names of the sensors that were suspected persistently, in plant order."""
        return tuple(s.name for s in self.sensors if s.lies)

    @property
    def verdict(self) -> str:
        """One plain sentence.

        Examples:
            >>> Summary("", "SparseFusion", 9, (), (), None, None, None).verdict
            'No sensor is suspected.'
        """
        return self.verdict_with(str)

    @property
    def caveat(self) -> str:
        """How many sensors the verdict says nothing about, as one sentence; empty if there is none."""
        alone = sum(s.uncheckable for s in self.sensors)
        if not alone:
            return ""
        share = f"{alone} of {count(len(self.sensors), 'sensor')} cannot be checked"
        return f"{share}: no other sensor vouches for {'it' if alone == 1 else 'them'}."

    def verdict_with(self, mark: Callable[[str], str]) -> str:
        """The verdict with every name in it as `mark` gives it, for instance as HTML."""
        liars = self.liars
        outvoted = not (self.estimator in BY_PROTECTED and any(s.protected for s in self.sensors))
        if outvoted and 2 * len(liars) >= len(self.sensors) > 1:
            return (
                f"{len(liars)} of {len(self.sensors)} sensors contradict the plant, too many to blame them: "
                "check its matrices, units and inputs (`judge` says whether it still fits), and whether the "
                "state starts at the operating point (else start with a window)."
            )
        if liars:
            share = f"{len(liars)} of {len(self.sensors)} sensors {'lies' if len(liars) == 1 else 'lie'}"
            return f"{share}: {enumerate_names(tuple(map(mark, liars)))}."
        if any(s.first_alarm for s in self.sensors):
            return "No sensor lies persistently; there are isolated alarms."
        if self.estimator == "KalmanFilter":
            return "KalmanFilter trusts every sensor: it does not look for liars."
        return "No sensor is suspected."


def summarise(run: Run) -> Summary:
    """Summarise one run.

    Raises:
        InputError: names `run` if it is a batch of runs or holds no sample.
    """
    require_one_run(run)
    return Summary(
        plant=run.plant.name,
        estimator=run.estimator,
        samples=run.x.shape[0],
        sensors=tuple(_sensor(run, i) for i in range(run.plant.n_sensors)),
        statuses=_statuses(run.status),
        fast_path=_fast_path(run),
        iterations=_iterations(run),
        gap=_worst(run.diagnostics.get("gap")),
    )


def require_one_run(run: Run) -> None:
    """Raise InputError unless `run` is one run of at least one sample."""
    if run.x.ndim != 2 or run.x.shape[0] == 0:
        raise InputError("run", "one run, x of shape (T, n) with T >= 1", f"x of shape {run.x.shape}")


def _sensor(run: Run, i: int) -> SensorSummary:
    suspected, missing = run.suspected[:, i], _silent(run, i)
    since = _persistent_since(suspected, missing)
    return SensorSummary(
        name=run.plant.sensor_names[i],
        protected=bool(run.plant.protected[i]),
        uncheckable=bool(run.plant.uncheckable[i]),
        suspected=float(suspected.mean()),
        missing=float(missing.mean()),
        first_alarm=_moment(run, _first(suspected)),
        lies=since is not None,
        since=_moment(run, since),
        injections=_injections(run, i),
    )


def _silent(run: Run, i: int) -> NDArray[np.bool_]:
    """Where a sensor sent nothing, (T,): no channel has an innovation or, in a cold start, an injection.

    A trust of NaN alone does not say so: what arrived may be impossible to check.
    """
    own = run.plant.channels_of(i)
    unheard = np.isnan(run.innovation[:, own]) & np.isnan(run.attack[:, own])
    silent: NDArray[np.bool_] = np.isnan(run.trust[:, i]) & unheard.all(axis=1)
    return silent


def _first(flags: NDArray[np.bool_]) -> int | None:
    return int(np.argmax(flags)) if flags.any() else None


def _moment(run: Run, index: int | None) -> Moment | None:
    if index is None:
        return None
    return Moment(index, None if run.time is None else run.time[index])


def _persistent_since(suspected: NDArray[np.bool_], missing: NDArray[np.bool_]) -> int | None:
    """Index of the first suspected sample in the first WINDOW sent samples that are half suspected."""
    sent = np.flatnonzero(~missing | suspected)
    if sent.size == 0:
        return None
    width = min(WINDOW, sent.size)
    total = np.concatenate([[0], np.cumsum(suspected[sent])])
    start = _first(2 * (total[width:] - total[:-width]) >= width)
    if start is None:
        return None
    return int(sent[start + int(np.argmax(suspected[sent[start:]]))])


def _injections(run: Run, i: int) -> tuple[Injection, ...]:
    suspected, channels = run.suspected[:, i], run.plant.channels_of(i)
    names, units = run.plant.channel_names[channels], run.plant.units[channels]
    estimates = zip(names, units, run.attack[suspected, channels].T, strict=True)
    return tuple(Injection(name, unit, *_centre(values)) for name, unit, values in estimates)


def _centre(values: NDArray[np.float64]) -> tuple[float, float]:
    """Median and spread of the finite values; NaN, NaN if there is none."""
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return float("nan"), float("nan")
    median = float(np.median(finite))
    return median, 1.4826 * float(np.median(np.abs(finite - median)))


def _statuses(status: NDArray[np.uint8]) -> tuple[StatusCount, ...]:
    codes, counts = np.unique(status, return_counts=True)
    return tuple(
        StatusCount(Status(int(code)).name, int(count), Status(int(code)).advice)
        for code, count in zip(codes, counts, strict=True)
    )


def _fast_path(run: Run) -> float | None:
    flags = run.diagnostics.get("fast_path")
    return None if flags is None or np.isnan(flags).all() else float(np.nanmean(flags))


def _iterations(run: Run) -> float | None:
    iterations = run.diagnostics.get("iterations")
    if iterations is None:
        return None
    fast = run.diagnostics.get("fast_path", np.zeros_like(iterations))
    solved = iterations[(fast != 1) & np.isfinite(iterations)]
    return float(np.median(solved)) if solved.size else None


def _worst(values: NDArray[np.float64] | None) -> float | None:
    return None if values is None or np.isnan(values).all() else float(np.nanmax(values))

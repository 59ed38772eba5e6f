"""What a run says, in numbers: how often and since when each sensor was suspected, how the solver fared."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from securestate._words import count, enumerate_names
from securestate.estimators.base import Status
from securestate.reporting.clock import Moment
from securestate.reporting.episodes import silent
from securestate.reporting.findings import Findings, find

if TYPE_CHECKING:
    from securestate.estimators.run import Run


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

    `lies` tells a sensor that was suspected persistently from one with brief or isolated alarms: at least
    half of some 20 samples in a row (of those it sent) were suspected, and not faintly. `since` is where the
    first such stretch begins. `blamed`: it lies, and not only while at least half of all sensors were
    suspected at once.
    `uncheckable`: it may lie and no other sensor can vouch for it, so that no alarm is no evidence.
    """

    name: str
    protected: bool
    uncheckable: bool
    suspected: float
    missing: float
    first_alarm: Moment | None
    lies: bool
    blamed: bool
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
    findings: Findings
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
        """One or two plain sentences."""
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
        blamed = tuple(s.name for s in self.sensors if s.blamed)
        liars, total = self.liars, len(self.sensors)
        if liars and not blamed:
            return (
                f"{len(liars)} of {total} sensors contradict the plant, too many to blame them: "
                "check its matrices, units and inputs (`judge` says whether it still fits), and whether the "
                "state starts at the operating point (else start with a window)."
            )
        if liars:
            share = f"{len(blamed)} of {total} sensors {'lies' if len(blamed) == 1 else 'lie'}"
            named = f"{share}: {enumerate_names(tuple(map(mark, blamed)))}."
            others = len(liars) - len(blamed)
            return f"{named} At times {others} more contradict the plant together." if others else named
        if any(s.first_alarm for s in self.sensors):
            brief = tuple(dict.fromkeys(mark(f.sensor) for f in self.findings.found))
            kinds = {f.verdict for f in self.findings.found}
            kind = " or ".join(word for word in ("brief", "faint") if word in kinds)
            whose = f"{kind} alarms of {enumerate_names(brief)}" if brief else "isolated alarms"
            return f"No sensor lies persistently; there are {whose}."
        if self.estimator == "KalmanFilter":
            return "KalmanFilter trusts every sensor: it does not look for liars."
        return "No sensor is suspected."


def summarise(run: Run) -> Summary:
    """Summarise one run.

    Raises:
        InputError: names `run` if it is a batch of runs or holds no sample.
    """
    findings = find(run)
    return Summary(
        plant=run.plant.name,
        estimator=run.estimator,
        samples=run.x.shape[0],
        findings=findings,
        sensors=tuple(_sensor(run, findings, i) for i in range(run.plant.n_sensors)),
        statuses=_statuses(run.status),
        fast_path=_fast_path(run),
        iterations=_iterations(run),
        gap=_worst(run.diagnostics.get("gap")),
    )


def _sensor(run: Run, findings: Findings, i: int) -> SensorSummary:
    suspected, name = run.suspected[:, i], run.plant.sensor_names[i]
    lies = [f for f in findings.of(name) if f.verdict not in ("brief", "faint")]
    first = _first(suspected)
    return SensorSummary(
        name=name,
        protected=bool(run.plant.protected[i]),
        uncheckable=bool(run.plant.uncheckable[i]),
        suspected=float(suspected.mean()),
        missing=float(silent(run, i).mean()),
        first_alarm=None if first is None else Moment.of(run, first),
        lies=bool(lies),
        blamed=any(f.lies for f in lies),
        since=min((f.since for f in lies), key=lambda moment: moment.index, default=None),
        injections=_injections(run, i),
    )


def _first(flags: NDArray[np.bool_]) -> int | None:
    return int(np.argmax(flags)) if flags.any() else None


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

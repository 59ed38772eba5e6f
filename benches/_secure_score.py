"""One run scored, and the runs of a cell summed up."""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from benches._secure_cells import PAPER, Cell, Episode, episode, of_paper
from benches._secure_limit import WAYS, Way, limit
from benches._secure_methods import ORACLE, TOLD, Design, variant
from securestate import Estimator, OracleFilter, SecurestateError, SecurestateWarning, Status
from securestate.simulation.metrics import PER_RUN, score

Float = NDArray[np.float64]

#: What is kept of a run under a method; numbers of samples with each status follow.
KEPT = ("mse", "nees", "honest", "false_alarms", "lies", "detections", "seconds")
_COLUMNS = [PER_RUN.index(name) for name in KEPT[:-1]]
LEVEL = 0.95


@dataclass(frozen=True)
class Result:
    """The runs of one method in one cell.

    Attributes:
        rows: numbers of every run, in the order of `KEPT`, then how often each status came.
        refused: why the method does not take part; empty: it does.
    """

    rows: list[list[float]] = field(default_factory=list)
    refused: str = ""

    def column(self, name: str) -> Float:
        """One number of every run."""
        return np.array([row[KEPT.index(name)] for row in self.rows], dtype=np.float64)

    @property
    def statuses(self) -> dict[str, int]:
        """How many samples had each status, those that came at all."""
        counts = np.sum([row[len(KEPT) :] for row in self.rows], axis=0)
        return {status.name: int(n) for status, n in zip(Status, counts, strict=True) if n}


Results = dict[str, Result]


def attempt(cell: Cell, seed: int, names: Sequence[str]) -> Results:
    """One run of a cell by every method named, and the limits; all see the same one."""
    limits = {name: _limit(cell, seed, WAYS[name]) for name in names if name in WAYS}
    return _attempts(cell, seed, [name for name in names if name not in WAYS]) | limits


def _limit(cell: Cell, seed: int, way: Way) -> Result:
    """It knows neither whom to suspect nor a covariance to check, so that only its error counts."""
    begin = time.process_time()
    mse = limit(cell, seed, way)
    none = [float("nan"), 0.0, 0.0, 0.0, 0.0, time.process_time() - begin, *[0.0] * len(Status)]
    return Result([[mse, *none]])


def _attempts(cell: Cell, seed: int, names: Sequence[str]) -> Results:
    drawn = episode(cell, seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SecurestateWarning)  # limits of a plant, doubtful windows
        if cell.plant not in PAPER:
            return {name: _one(drawn, found(name)) for name in names}
        return {name: _one(drawn, _once(cell.plant, name)) for name in names}


def _once(kind: str, name: str) -> Design:
    return lambda _: _of_paper(kind, name)


@cache
def _of_paper(kind: str, name: str) -> Estimator | OracleFilter:
    """Designed once for the plant that all runs share."""
    return found(name)(of_paper(kind))


def found(name: str) -> Design:
    """The method of this name, which there must be."""
    design = variant(name)
    assert design is not None, name
    return design


def _one(drawn: Episode, design: Design) -> Result:
    try:
        estimator = design(drawn.trajectory.plant)
        begin = time.process_time()
        run, met = drawn.confront(estimator)
    except SecurestateError as error:
        return Result(refused=str(error))
    seconds = time.process_time() - begin
    numbers = score(run, met, drawn.scored).per_run[0, _COLUMNS]
    counts = np.bincount(run.status[0, drawn.scored :], minlength=len(Status))
    return Result([[*numbers.tolist(), seconds, *counts.tolist()]])


def join(parts: Sequence[Results]) -> Results:
    """The runs of all parts in order; who refuses once is out."""
    names = list(dict.fromkeys(name for part in parts for name in part))
    joined = {}
    for name in names:
        own = [part[name] for part in parts if name in part]
        refused = next((one.refused for one in own if one.refused), "")
        joined[name] = Result([] if refused else [row for one in own for row in one.rows], refused)
    return joined


@dataclass(frozen=True)
class Summary:
    """A method in a cell.

    Attributes:
        runs: how many.
        ratio, error: mean squared error over the oracle's on the same runs, and its standard error.
        median: of the same ratio run by run; far below `ratio` where few runs decide.
        honest, attacked: share of sensor-samples under suspicion, of honest sensors and of those that lied.
        nees: mean of e' P^-1 e / n, and the 95 % interval of that mean from the spread between runs.
        statuses: how many samples had each status.
        milliseconds: of all samples of a run, without the design.
    """

    runs: int
    ratio: float
    error: float
    median: float
    honest: float
    attacked: float
    nees: tuple[float, float, float]
    statuses: Mapping[str, int]
    milliseconds: float


def summarise(results: Results) -> dict[str, Summary]:
    """Every method that took part, in the order of the results."""
    oracle = results[ORACLE].column("mse")
    return {name: _summary(one, oracle) for name, one in results.items() if one.rows}


def _summary(one: Result, oracle: Float) -> Summary:
    mse = one.column("mse")
    ratio, error = relative(mse, oracle)
    with np.errstate(all="ignore"):
        honest = one.column("false_alarms").sum() / one.column("honest").sum()
        attacked = one.column("detections").sum() / one.column("lies").sum()
    return Summary(
        runs=len(mse),
        ratio=ratio,
        error=error,
        median=float(np.median(mse / oracle[: len(mse)])),
        honest=float(honest),
        attacked=float(attacked),
        nees=_interval(one.column("nees")),
        statuses=one.statuses,
        milliseconds=1e3 * float(one.column("seconds").mean()),
    )


def _interval(values: Float) -> tuple[float, float, float]:
    """Mean, and the 95 % interval of it from independent values."""
    mean, count = float(values.mean()), len(values)
    if count < 2 or not np.isfinite(mean):
        return mean, np.nan, np.nan
    half = float(stdtrit(count - 1, (1 + LEVEL) / 2) * values.std(ddof=1) / np.sqrt(count))
    return mean, mean - half, mean + half


def relative(mse: Float, other: Float) -> tuple[float, float]:
    """Mean over mean of the other's first runs, which are the same ones, and its standard error."""
    other = other[: len(mse)]
    with np.errstate(all="ignore"):
        ratio = float(mse.mean() / other.mean())
        if len(mse) < 2 or not np.isfinite(ratio):
            return ratio, float("nan")
        spread = (mse / mse.mean() - other / other.mean()).std(ddof=1)
    return ratio, float(ratio * spread / np.sqrt(len(mse)))


def against_best(results: Results, name: str) -> tuple[float, float, str]:
    """Its mean squared error over that of the best other method on the same runs, its error, and who that is.

    Who is told more than readings does not count.
    """
    own = results[name].column("mse")
    rivals = {}
    for other, one in results.items():
        if other == name or other in TOLD or not one.rows:
            continue
        common = min(len(own), len(one.rows))
        rivals[other] = relative(own[:common], one.column("mse"))
    if not rivals:
        return float("nan"), float("nan"), ""
    best = max(rivals, key=lambda other: (np.nan_to_num(rivals[other][0], nan=-np.inf), other))
    return *rivals[best], best

"""What a lying sensor adds to its readings over time: how much, and whether it stays, grows or jumps."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from securestate.reporting.blocks import channel_noise
from securestate.reporting.chance import REMEMBERING
from securestate.reporting.episodes import Episode

if TYPE_CHECKING:
    from securestate.estimators.run import Run

Float = NDArray[np.float64]

PART = 10
"""Estimates that a course, and each part of it, rising or level, holds at least; of fewer nobody can tell."""

POINTS = 60
"""A course is fitted to so many points at most, medians over equal stretches."""

BETTER = 0.75
"""A course with a slope leaves at most this share of the scatter of one without."""

SLOPE = 3.0
"""It changes by more than so many standard deviations of the scatter."""


class Kind(StrEnum):
    """How an injection goes on."""

    CONSTANT = "constant"
    GROWING = "growing"
    SETTLING = "settling"
    ERRATIC = "erratic"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class Course:
    """What a sensor adds to one channel during an episode, in file units; NaN if there is no estimate.

    Attributes:
        channel: its name.
        unit: its unit.
        kind: CONSTANT; GROWING by `slope` per sample from `first` to `last`; SETTLING, the same until sample
            `settled` and level after it; ERRATIC; UNKNOWN, from fewer than PART estimates.
        first: the injection at the beginning.
        last: the injection at the end.
        size: its typical absolute value: of `last`, or the root mean square if it is erratic.
        spread: standard deviation of single estimates about the course, from the median absolute deviation;
            at least `error` if the estimator remembers, so that they scatter less than they err.
        slope: change per sample, 0 if it is level throughout.
        settled: sample from which a settling one is level.
        noise: standard deviation of the channel's measurement noise.
        error: standard deviation that the estimator states for a single estimate, or else `noise`.
    """

    channel: str
    unit: str
    kind: Kind
    first: float
    last: float
    size: float
    spread: float
    slope: float
    settled: int | None
    noise: float
    error: float

    @property
    def known(self) -> bool:
        """Whether the estimator had an estimate."""
        return not math.isnan(self.size)

    @property
    def clear(self) -> bool:
        """Whether it stands out of its own scatter, or an erratic one out of its error."""
        return self.size >= (2 * self.error if self.kind is Kind.ERRATIC else self.spread)

    @property
    def in_noise(self) -> float:
        """Typical size in standard deviations of the measurement noise; 0 if unknown."""
        return self.size / self.noise if self.known and self.noise > 0 else 0.0


def courses(run: Run, sensor: int, episode: Episode) -> tuple[Course, ...]:
    """The courses of all channels of a sensor in an episode."""
    remembered = run.estimator in REMEMBERING
    rows = np.arange(episode.start, episode.stop + 1)
    rows = rows[run.suspected[rows, sensor]]
    noise = channel_noise(run.plant)
    found = []
    for c in np.arange(run.plant.m)[run.plant.channels_of(sensor)]:
        estimate, error = run.attack[rows, c], run.attack_std[rows, c]
        known = np.isfinite(estimate)
        stated = error[known & np.isfinite(error)]
        one = course(
            rows[known].astype(np.float64),
            estimate[known],
            channel=run.plant.channel_names[c],
            unit=run.plant.units[c],
            noise=float(noise[c]),
            error=float(np.median(stated)) if stated.size else float(noise[c]),
            early=float(np.median(stated[:PART])) if remembered and stated.size else 0.0,
        )
        found.append(replace(one, spread=max(one.spread, one.error)) if remembered and one.known else one)
    return tuple(found)


def course(
    t: Float, values: Float, *, channel: str, unit: str, noise: float, error: float, early: float = 0.0
) -> Course:
    """The course of single estimates `values` at samples `t`, both (k,) and finite.

    `early` is the error of the first estimates, if later ones follow from them: what the estimator learns is
    no change of the injection.

    Examples:
        >>> t = np.arange(100.0)
        >>> grown = course(t, 0.5 * t, channel="flow", unit="l/s", noise=1.0, error=1.0)
        >>> print(grown.kind, grown.slope, grown.last)
        growing 0.5 49.5
    """
    if not values.size:
        nan = math.nan
        return Course(channel, unit, Kind.UNKNOWN, nan, nan, nan, nan, 0.0, None, noise, error)
    slope, knee, fitted = _fitted(t, values, early)
    spread = _scatter(values - fitted)
    first, last = float(fitted[0]), float(fitted[-1])
    size = max(abs(first), abs(last))
    kind = Kind.CONSTANT if not slope else Kind.GROWING if knee is None else Kind.SETTLING
    if values.size < PART:
        kind = Kind.UNKNOWN
    elif (spread > size / 2 and spread > 2 * error) or spread > 4 * size:
        middle = float(np.median(values))
        kind, slope, knee, first, last = Kind.ERRATIC, 0.0, None, middle, middle
        size, spread = float(np.sqrt(np.mean(values**2))), _scatter(values - middle)
    settled = None if knee is None else int(knee)
    size = size if kind is Kind.ERRATIC else abs(last) if kind is not Kind.GROWING else size
    return Course(channel, unit, kind, first, last, size, spread, slope, settled, noise, error)


def _fitted(t: Float, values: Float, early: float) -> tuple[float, float | None, Float]:
    """Slope, sample at which it ends (None: it does not), and values of the simplest course that fits."""
    level = np.full(values.size, np.median(values))
    if values.size < 2 * PART:
        found = _line_of_few(t, values, level)
        return found if _changes(found[2], early) else (0.0, None, level)
    where, points = _points(t), _points(values)
    best: tuple[float, float | None, Float] = (0.0, None, level)
    least = _rms(points - np.median(points))
    for knee in (None, *np.unique(np.percentile(t, np.arange(5, 100, 5))).tolist()):
        if knee is not None and min(np.sum(t <= knee), np.sum(t > knee)) < PART:
            continue
        base, slope = _straight(_bent(where, knee), points)
        left = _rms(points - base - slope * _bent(where, knee))
        fitted = base + slope * _bent(t, knee)
        if left < BETTER * least and _changes(fitted, max(early, _scatter(values - fitted))):
            best, least = (slope, knee, fitted), left if knee is None else left / BETTER
    return best


def _changes(fitted: Float, error: float) -> bool:
    return bool(abs(fitted[-1] - fitted[0]) > SLOPE * error)


def _line_of_few(t: Float, values: Float, level: Float) -> tuple[float, float | None, Float]:
    """A level or straight course for at least PART and less than twice as many values."""
    if values.size < PART:
        return 0.0, None, level
    base, slope = _straight(t, values)
    fitted = base + slope * t
    better = _rms(values - fitted) < BETTER**2 * _rms(values - level)
    return (slope, None, fitted) if better else (0.0, None, level)


def _bent(t: Float, knee: float | None) -> Float:
    return t if knee is None else np.minimum(t, knee)


def _points(values: Float) -> Float:
    """Medians over at most POINTS stretches of equal length."""
    parts = np.array_split(values, min(POINTS, values.size))
    return np.array([np.median(part) for part in parts])


def _straight(t: Float, values: Float) -> tuple[float, float]:
    """Value at t = 0 and slope of the least-squares line."""
    centre = t.mean()
    spread = float(np.sum((t - centre) ** 2))
    slope = float(np.sum((t - centre) * values)) / spread if spread > 0 else 0.0
    return float(values.mean() - slope * centre), slope


def _scatter(residuals: Float) -> float:
    """A standard deviation, from the median absolute deviation."""
    return 1.4826 * float(np.median(np.abs(residuals - np.median(residuals))))


def _rms(residuals: Float) -> float:
    return float(np.sqrt(np.mean(residuals**2)))

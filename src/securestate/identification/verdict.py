"""Is this model good enough to judge sensors by? Criteria with limits, and a plain sentence per problem."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import final

import numpy as np
from numpy.typing import NDArray

from securestate._words import count, enumerate_names
from securestate.identification.residuals import LAGS, Residuals

Array = NDArray[np.float64]


class Grade(StrEnum):
    """How far a model can be trusted to judge sensors."""

    GOOD = "good"
    USABLE = "usable"
    INADEQUATE = "inadequate"


@final
@dataclass(frozen=True)
class Limits:
    """From where on a number is a problem: `usable` of a usable model, `inadequate` of an inadequate one."""

    usable: float
    inadequate: float

    def grade(self, value: float) -> Grade:
        """The best grade that a model with this number can have."""
        if not value <= self.inadequate:
            return Grade.INADEQUATE
        return Grade.USABLE if value > self.usable else Grade.GOOD


#: Prediction errors over what the model says, as a variance: too large, and (inverse) too small.
TOO_LARGE, TOO_SMALL = Limits(1.15, 1.5), Limits(1 / 0.9, 1 / 0.7)

#: The same of one channel, or its inverse; readings that it must have.
ONE_CHANNEL, LEAST_READ = Limits(2.0, np.inf), 50

#: Share of samples above the 5 % limit.
EXCEED = Limits(0.08, 0.20)

#: Autocorrelation of innovations at lag 1: over all channels (root mean square), and of the worst.
REPEATS, REPEATS_WORST = Limits(0.08, 0.15), Limits(0.3, np.inf)

#: The same over ten lags (root of the sum of squares): oscillations that the model lacks.
COLOUR = Limits(0.2, 0.35)

#: Shift of innovations, of their halves, or of the level, in standard deviations.
SHIFT = Limits(0.35, 1.0)

#: What may be chance counts as nothing: up to so many standard errors, and of a share so many.
SURE, SURE_SHARE = 4.0, 3.0

#: The worst block over the median block.
COLLAPSE = Limits(np.inf, 4.0)

#: Share of samples in which the estimator suspects an honest sensor.
SUSPECTED = Limits(0.03, 0.25)

#: Fewer samples than this cannot say that a model is good, or anything.
FEW, TOO_SHORT = 50, 10

#: Growth of errors on new data because parameters were fitted, 2 k / (N m).
TOO_FEW = Limits(0.06, 0.25)


@final
@dataclass(frozen=True)
class Criterion:
    """One number that a grade rests on.

    Attributes:
        name: what it is, in a few words.
        shown: the number. channel: the channel it belongs to; empty if it is of all.
        value: what is compared with the limits: `shown`, its inverse if it is too small, or 0 if it may be
            chance.
        limits: from where on a model is only usable, or inadequate.
        text: a sentence for an engineer, if it is a problem.
        ideal: of a perfect model. unit: "", "%" of a share, or "sd".
    """

    name: str
    shown: float
    channel: str
    value: float
    limits: Limits
    text: str
    ideal: float = 0.0
    unit: str = ""

    @property
    def grade(self) -> Grade:
        """The best grade that a model with this number can have."""
        return self.limits.grade(self.value)


@final
@dataclass(frozen=True)
class Problem:
    """One thing that is wrong.

    Attributes:
        grade: the best grade a model with this problem can have.
        text: a sentence for an engineer.
    """

    grade: Grade
    text: str

    def __str__(self) -> str:
        return self.text


def criteria(found: Residuals, names: Sequence[str], parameters: float | None) -> Iterator[Criterion]:
    """Everything a model is judged by, on a record it was not fitted to.

    Args:
        found: of that record, which has samples. names: of the channels, (m,).
        parameters: expected growth of errors because of the number of parameters; None if not known.
    """
    yield _size(found)
    yield _worst_size(found, names)
    yield _exceed(found)
    yield from _whiteness(found, names)
    yield from _shift(found, names)
    worst = found.worst_block / max(found.median_block, 0.25)
    yield Criterion(
        "Worst part of the record over the median",
        worst,
        "",
        worst,
        COLLAPSE,
        f"The fit collapses in part of the record: errors there are {found.worst_block:.3g} times what the "
        f"model says, elsewhere {found.median_block:.3g} times.",
        ideal=1.0,
    )
    if parameters is not None:
        yield Criterion(
            "Growth of errors because parameters were fitted",
            parameters,
            "",
            parameters,
            TOO_FEW,
            "Too little data: the model has so many parameters that its errors grow by about "
            f"{100 * parameters:.0f} % on new data for that reason alone.",
            unit="%",
        )


def _size(found: Residuals) -> Criterion:
    small = found.size < 1
    chance = SURE_SHARE * np.sqrt(2 / max(int(found.channels.sum()), 1))
    off = 1 / max(found.size, 1e-300) if small else found.size
    return Criterion(
        "Errors over what the model says, as a variance",
        found.size,
        "",
        off if abs(found.size - 1) > chance else 1.0,
        TOO_SMALL if small else TOO_LARGE,
        f"Prediction errors have {found.size:,.3g} times the variance that the model says.",
        ideal=1.0,
    )


def _worst_size(found: Residuals, names: Sequence[str]) -> Criterion:
    """The channel whose errors fit the model worst, too large or too small."""
    variance = np.where(found.counted >= LEAST_READ, np.nan_to_num(found.variance, nan=1.0), 1.0)
    chance = SURE * np.sqrt(2 / np.maximum(found.counted, 1))
    off = np.where(np.abs(variance - 1) > chance, np.maximum(variance, 1 / np.maximum(variance, 1e-300)), 1.0)
    i = int(np.argmax(off))
    return Criterion(
        "The same, worst channel",
        float(variance[i]),
        names[i] if off[i] > 1 else "",
        float(off[i]),
        ONE_CHANNEL,
        f"Errors of {names[i]} have {variance[i]:,.3g} times the variance that the model says.",
        ideal=1.0,
    )


def _exceed(found: Residuals) -> Criterion:
    chance = 0.05 + SURE_SHARE * np.sqrt(0.05 * 0.95 / found.samples)
    return Criterion(
        "Samples beyond the limit for 5 %",
        found.exceed,
        "",
        found.exceed if found.exceed > chance else 0.0,
        EXCEED,
        f"{100 * found.exceed:.0f} % of the samples are beyond the limit for 5 %.",
        unit="%",
    )


def _whiteness(found: Residuals, names: Sequence[str]) -> Iterator[Criterion]:
    error = 1 / np.sqrt(np.maximum(found.counted, 1))
    first = np.abs(np.nan_to_num(found.repeat[0]))
    sure = np.where(first > SURE * error, first, 0.0)
    yield Criterion(
        "Errors repeat from sample to sample, all channels",
        found.repeats,
        "",
        found.repeats if sure.any() else 0.0,
        REPEATS,
        f"Errors repeat themselves from sample to sample (correlation {found.repeats:.2f}): the model lacks "
        f"dynamics. Worst: {_worst(first, names)}.",
    )
    yield _of_worst(
        "The same, worst channel",
        sure,
        names,
        REPEATS_WORST,
        "The errors of some sensors repeat themselves from sample to sample:",
    )
    chance = np.sqrt(2 * LAGS) / np.maximum(found.counted, 1)  # of a sum of squares, standard deviation
    by_channel = found.colour_by_channel
    surely = bool(np.any(by_channel**2 > SURE * chance))
    yield Criterion(
        f"Errors repeat within {LAGS} samples, all channels",
        found.colour,
        "",
        found.colour if surely else 0.0,
        COLOUR,
        f"Errors of up to {LAGS} samples ago come back (correlation {found.colour:.2f} in all): the model "
        f"lacks dynamics. Worst: {_worst(by_channel, names)}.",
    )


def _shift(found: Residuals, names: Sequence[str]) -> Iterator[Criterion]:
    error = 1 / np.sqrt(np.maximum(found.counted, 1))
    for name, values, errors, text in (
        (
            "Plant away from its operating point",
            found.level,
            found.level_error * np.sqrt(2),
            "The plant is elsewhere than where the model was made, in standard deviations:",
        ),
        (
            "Predictions off on average",
            found.shift,
            error,
            "Predictions are off on average, in standard deviations:",
        ),
        (
            "Errors drift within the record",
            found.change,
            2 * error,
            "Errors drift within the record, in standard deviations:",
        ),
    ):
        size = np.abs(np.nan_to_num(values))
        yield _of_worst(name, np.where(size > SURE * errors, size, 0.0), names, SHIFT, text, "sd")


def _of_worst(
    name: str, sizes: Array, names: Sequence[str], limits: Limits, text: str, unit: str = ""
) -> Criterion:
    """The criterion of the worst channel; sizes that may be chance are 0."""
    i = int(np.argmax(sizes))
    size = float(sizes[i])
    said = f"{text} {_worst(sizes, names)}."
    return Criterion(name, size, names[i] if size > 0 else "", size, limits, said, unit=unit)


def _worst(values: Array, names: Sequence[str]) -> str:
    """The largest three that are at least half of the largest, with their values."""
    order = np.argsort(values)[::-1][:3]
    return enumerate_names([f"{names[i]} {values[i]:.2f}" for i in order if values[i] >= values.max() / 2])


def rehearsed(shares: Array, names: Sequence[str]) -> Criterion:
    """How often sparse fusion suspects sensors of a record in which nobody lied; the worst sensor."""
    i = int(np.argmax(shares))
    return Criterion(
        "Samples in which sparse fusion suspects an honest sensor",
        float(shares[i]),
        names[i] if shares[i] > 0 else "",
        float(shares[i]),
        SUSPECTED,
        f"Sparse fusion suspects {names[i]} in {100 * shares[i]:.0f} % of the samples. If nobody lied, the "
        "model is not good enough for it: see whether innovation-mixture does better.",
        unit="%",
    )


def problems(found: Sequence[Criterion], samples: int) -> list[Problem]:
    """What is wrong, one sentence each; what another sentence says already is left out.

    Args:
        samples: that judge.
    """
    few = f"Only {count(samples, 'sample')} to judge the model by: much may still be chance."
    said = [Problem(Grade.INADEQUATE if samples < TOO_SHORT else Grade.USABLE, few)] if samples < FEW else []
    said += [Problem(one.grade, one.text) for one in found if one.grade is not Grade.GOOD]
    lag_one = any(one.limits is REPEATS and one.grade is not Grade.GOOD for one in found)
    worst = next((one.text for one in found if one.limits is REPEATS_WORST), "")
    return [one for one in said if not (lag_one and one.text == worst)]


def overall(found: Sequence[Problem]) -> Grade:
    """The worst grade among the problems."""
    grades = {problem.grade for problem in found}
    return next((g for g in (Grade.INADEQUATE, Grade.USABLE) if g in grades), Grade.GOOD)

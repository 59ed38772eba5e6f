"""Is this model good enough to judge sensors by? A grade, and one plain sentence per problem."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import final

import numpy as np
from numpy.typing import NDArray

from securestate._words import enumerate_names
from securestate.identification.residuals import Residuals

Array = NDArray[np.float64]


class Grade(StrEnum):
    """How far a model can be trusted to judge sensors."""

    GOOD = "good"
    USABLE = "usable"
    INADEQUATE = "inadequate"


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


@final
@dataclass(frozen=True)
class Limits:
    """From where on a number is a problem: `usable` of a usable model, `inadequate` of an inadequate one."""

    usable: float
    inadequate: float

    def grade(self, value: float) -> Grade | None:
        """The best grade that a model with this number can have, None if there is nothing to say."""
        if not value <= self.inadequate:
            return Grade.INADEQUATE
        return Grade.USABLE if value > self.usable else None


#: Prediction errors over what the model says, as a variance: too large, and (inverse) too small.
TOO_LARGE, TOO_SMALL = Limits(1.15, 1.5), Limits(1 / 0.9, 1 / 0.7)

#: Share of samples above the 5 % limit.
EXCEED = Limits(0.08, 0.20)

#: Autocorrelation of innovations at lag 1: over all channels (root mean square), and of the worst.
REPEATS, REPEATS_WORST = Limits(0.08, 0.15), Limits(0.3, np.inf)

#: Shift of innovations, of their halves, or of the level, in standard deviations.
SHIFT = Limits(0.35, 1.0)

#: A shift counts from so many standard errors on.
SURE = 4.0

#: The worst block over the median block.
COLLAPSE = Limits(np.inf, 4.0)

#: Growth of errors on new data because parameters were fitted, 2 k / (N m).
TOO_FEW = Limits(0.06, 0.25)


def problems(found: Residuals, names: Sequence[str], parameters: float | None) -> Iterator[Problem]:
    """Everything that is wrong with a model, judged by a record it was not fitted to.

    Args:
        found: of that record. names: of the channels, (m,).
        parameters: expected growth of errors because of the number of parameters; None if not known.
    """
    if found.samples == 0:
        yield Problem(Grade.INADEQUATE, "There is no sample to judge the model by.")
        return
    yield from _size(found)
    yield from _whiteness(found, names)
    yield from _shift(found, names)
    grade = COLLAPSE.grade(found.worst_block / max(found.median_block, 0.25))
    if grade is not None:
        yield Problem(
            grade,
            f"The fit collapses in part of the record: errors there are {found.worst_block:.1f} times what "
            f"the model says, elsewhere {found.median_block:.1f} times.",
        )
    grade = None if parameters is None else TOO_FEW.grade(parameters)
    if grade is not None and parameters is not None:
        yield Problem(
            grade,
            "Too little data: the model has so many parameters that its errors grow by about "
            f"{parameters:.0%} on new data for that reason alone.",
        )


def _size(found: Residuals) -> Iterator[Problem]:
    grade = TOO_LARGE.grade(found.size) or TOO_SMALL.grade(1 / max(found.size, 1e-300))
    if grade is not None:
        yield Problem(
            grade, f"Prediction errors have {found.size:.2f} times the variance that the model says."
        )
    noise = 3 * np.sqrt(0.05 * 0.95 / found.samples)
    grade = EXCEED.grade(found.exceed) if found.exceed > 0.05 + noise else None
    if grade is not None:
        yield Problem(grade, f"{found.exceed:.0%} of the samples are beyond the limit for 5 %.")


def _whiteness(found: Residuals, names: Sequence[str]) -> Iterator[Problem]:
    first = np.abs(np.nan_to_num(found.repeat[0]))
    sure = first > SURE / np.sqrt(np.maximum(found.counted, 1))
    grade = REPEATS.grade(found.repeats) if sure.any() else None
    worst = REPEATS_WORST.grade(float(first[sure].max())) if sure.any() else None
    if grade is not None:
        yield Problem(
            grade,
            f"Errors repeat themselves from sample to sample (correlation {found.repeats:.2f}): the model "
            f"lacks dynamics. Worst: {_worst(first, names)}.",
        )
    elif worst is not None:
        yield Problem(worst, f"The errors of some sensors repeat themselves: {_worst(first, names)}.")


def _shift(found: Residuals, names: Sequence[str]) -> Iterator[Problem]:
    error = 1 / np.sqrt(np.maximum(found.counted, 1))
    for values, errors, text in (
        (found.level, found.level_error * np.sqrt(2), "The plant is elsewhere than where the model was made"),
        (found.shift, error, "Predictions are off on average"),
        (found.change, 2 * error, "Errors drift within the record"),
    ):
        size = np.abs(np.nan_to_num(values))
        size = np.where(size > SURE * errors, size, 0.0)
        grade = SHIFT.grade(float(size.max()))
        if grade is not None:
            yield Problem(grade, f"{text}: {_worst(size, names, ' standard deviations')}.")
            return


def _worst(values: Array, names: Sequence[str], unit: str = "") -> str:
    """The largest three that are at least half of the largest, with their values."""
    order = np.argsort(values)[::-1][:3]
    return enumerate_names(
        [f"{names[i]} {values[i]:.2f}{unit}" for i in order if values[i] >= values.max() / 2]
    )


def overall(found: Sequence[Problem]) -> Grade:
    """The worst grade among the problems."""
    grades = {problem.grade for problem in found}
    return next((g for g in (Grade.INADEQUATE, Grade.USABLE) if g in grades), Grade.GOOD)

"""Interleaved timing: ours, theirs, ours, theirs, ...; medians, and the spread of the ratio over the rounds.

Times are CPU times of this process. With one thread they equal wall-clock times on an idle machine, and other
programs on a busy one do not count.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median
from time import process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]

#: A turn repeats its work until it has lasted this long, seconds.
TURN = 5e-3


class DisagreementError(Exception):
    """The two sides do not compute the same thing, so comparing their times means nothing."""


@dataclass(frozen=True)
class Contender:
    """One side of a comparison.

    Attributes:
        name: what the table calls it.
        work: the timed work, from what `prepare` returns to its result.
        samples: measurements that one call of `work` handles.
        prepare: untimed; gives every call the same fresh start.
    """

    name: str
    work: Callable[[Any], Float]
    samples: int
    prepare: Callable[[], Any] = lambda: None

    def result(self) -> Float:
        return self.work(self.prepare())

    def turn(self) -> float:
        """Seconds per sample."""
        total, calls = 0.0, 0
        while total < TURN:
            start = self.prepare()
            begin = process_time()
            self.work(start)
            total += process_time() - begin
            calls += 1
        return total / (calls * self.samples)


@dataclass(frozen=True)
class Comparison:
    """Two sides and how well they must agree.

    Attributes:
        case, size: what is measured.
        ours, theirs: the two sides; `theirs` None where nobody else does it.
        tolerance: largest difference of the results, relative to the largest number.
        precise: the rival with tightened tolerances, untimed, which is held to `tolerance` in its place;
            the error of what is timed is then only reported.
        target: smallest ratio asked for, if any.
        alike: False for two methods that answer differently, so that only their times are compared.
    """

    case: str
    size: str
    ours: Contender
    theirs: Contender | None
    tolerance: float = 0.0
    target: float | None = None
    precise: Contender | None = None
    alike: bool = True

    def difference(self) -> float:
        """Largest difference of the results, relative to the largest number. Also warms both sides up.

        Raises:
            DisagreementError: it exceeds the tolerance.
        """
        ours = self.ours.result()
        if self.theirs is None:
            return 0.0
        if not self.alike:
            self.theirs.result()
            return float("nan")
        judged = _difference(ours, (self.precise or self.theirs).result())
        if not judged <= self.tolerance:
            raise DisagreementError(f"{self.case} {self.size}: {self.theirs.name} differs by {judged:.1e}")
        return _difference(ours, self.theirs.result())


def _difference(ours: Float, theirs: Float) -> float:
    """Over the samples that both have."""
    count = min(len(ours), len(theirs))
    return float(np.abs(ours[:count] - theirs[:count]).max() / np.abs(theirs[:count]).max())


@dataclass(frozen=True)
class Measurement:
    """Seconds per sample of every round."""

    comparison: Comparison
    difference: float
    ours: Sequence[float]
    theirs: Sequence[float]

    @property
    def ratios(self) -> list[float]:
        return [theirs / ours for ours, theirs in zip(self.ours, self.theirs, strict=True)]

    @property
    def ratio(self) -> float:
        """How many times faster ours is: the median of the rounds' ratios."""
        return median(self.ratios)


def measure(comparison: Comparison, rounds: int, after_round: Callable[[], None]) -> Measurement:
    """Check that both sides agree, then let them take turns."""
    difference = comparison.difference()
    ours, theirs = [], []
    for _ in range(rounds):
        ours.append(comparison.ours.turn())
        if comparison.theirs is not None:
            theirs.append(comparison.theirs.turn())
        after_round()
    return Measurement(comparison, difference, ours, theirs)


def fastest(candidates: Sequence[Contender]) -> Contender:
    """The quickest of several ways to ask a rival for the same thing, so that it is compared at its best."""
    for candidate in candidates:
        candidate.result()
    return min(candidates, key=lambda candidate: min(candidate.turn() for _ in range(2)))

"""Why a model has its grade: every number the grade rests on, on a gauge of good, usable and inadequate."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from securestate.identification import verdict as limits
from securestate.reporting.comparison_tables import rate, scroll
from securestate.reporting.page import compact, table

if TYPE_CHECKING:
    from securestate.identification.residuals import Residuals
    from securestate.identification.verdict import Limits

Float = NDArray[np.float64]

WIDE, GOOD_END, USABLE_END = 100, 50, 80
"""Of a gauge: where it ends, where good ends, where usable ends."""


@dataclass(frozen=True)
class Criterion:
    """One number that a grade rests on.

    Attributes:
        name: what it is. text: the number as it is shown, with the channel it belongs to, HTML.
        value: what is compared with the limits; never below `ideal`.
        limits: from where on a model is only usable, or inadequate.
        ideal: the number of a perfect model.
        unit: of the limits as they are shown: "", "%", "sd".
        least: the limits from below, upside down, if there are any.
    """

    name: str
    text: str
    value: float
    limits: Limits
    ideal: float = 0.0
    unit: str = ""
    least: Limits | None = None


def criteria(found: Residuals, names: Sequence[str]) -> Iterator[Criterion]:
    """What a verdict looks at, in its order; what may be chance counts as nothing, as there."""
    error = 1 / np.sqrt(np.maximum(found.counted, 1))
    small = found.size < 1
    yield Criterion(
        "Errors over what the model says, as a variance",
        compact(found.size),
        1 / max(found.size, 1e-300) if small else found.size,
        limits.TOO_SMALL if small else limits.TOO_LARGE,
        1.0,
        least=limits.TOO_SMALL,
    )
    yield Criterion(
        "Samples beyond the limit for 5 %", rate(found.exceed), found.exceed, limits.EXCEED, unit="%"
    )
    first = np.abs(np.nan_to_num(found.repeat[0]))
    sure = np.where(first > limits.SURE * error, first, 0.0)
    repeats = found.repeats if sure.any() else 0.0
    yield Criterion(
        "Errors repeat from sample to sample, all channels", f"{repeats:.2f}", repeats, limits.REPEATS
    )
    yield _worst("The same, worst channel", sure, names, limits.REPEATS_WORST, "")
    for name, values, errors in (
        ("Plant away from its operating point", found.level, found.level_error * math.sqrt(2)),
        ("Predictions off on average", found.shift, error),
        ("Errors drift within the record", found.change, 2 * error),
    ):
        size = np.abs(np.nan_to_num(values))
        yield _worst(name, np.where(size > limits.SURE * errors, size, 0.0), names, limits.SHIFT, "sd")
    worst = found.worst_block / max(found.median_block, 0.25)
    yield Criterion("Worst part of the record over the median", compact(worst), worst, limits.COLLAPSE, 1.0)


def _worst(name: str, size: Float, names: Sequence[str], of: Limits, unit: str) -> Criterion:
    i = int(np.argmax(size))
    told = (
        f"{size[i]:.2f}{f' {unit}' if unit else ''}, {escape(names[i])}"
        if size[i] > 0
        else "none beyond chance"
    )
    return Criterion(name, told, float(size[i]), of, unit=unit)


def why(found: Residuals, names: Sequence[str]) -> str:
    """Every number the grade rests on, on a gauge of good, usable and inadequate."""
    head = ("What is looked at", "Good, usable, inadequate", "Here", "Good", "Usable")
    drawn = table(head, (_criterion(one) for one in criteria(found, names)))
    return scroll(drawn.replace("<table>", '<table class="gauges">', 1), "Why this grade")


def _criterion(one: Criterion) -> str:
    kind = str(one.limits.grade(one.value) or limits.Grade.GOOD)
    good, usable = _ranges(one)
    return (
        f'<tr><th scope="row">{escape(one.name)}</th><td class="gauge">{_gauge(one, kind)}</td>'
        f'<td class="{kind}">{one.text}</td><td>{good}</td><td>{usable}</td></tr>'
    )


def _ranges(one: Criterion) -> tuple[str, str]:
    """Which numbers are good, and which are usable; empty if there are none in between."""
    if one.least is not None:
        most = limits.TOO_LARGE
        return (
            f"{1 / one.least.usable:.2f} to {most.usable:.2f}",
            f"{1 / one.least.inadequate:.2f} to {most.inadequate:.2f}",
        )
    good, usable = min(one.limits.usable, one.limits.inadequate), one.limits.inadequate
    return _up_to(good, one.unit), _up_to(usable, one.unit) if good < usable else ""


def _up_to(value: float, unit: str) -> str:
    if math.isinf(value):
        return "any"
    return f"up to {100 * value:.0f} %" if unit == "%" else f"up to {value:g} {unit}".rstrip()


def _gauge(one: Criterion, kind: str) -> str:
    """Green, amber and red stretches, and a mark where the number stands."""
    good, usable = min(one.limits.usable, one.limits.inadequate), one.limits.inadequate
    green = GOOD_END if good < usable else USABLE_END
    amber = USABLE_END if math.isfinite(usable) else WIDE
    if not one.value > good:
        place = green * max(0.0, one.value - one.ideal) / (good - one.ideal)
    elif one.value > usable:
        place = amber + (WIDE - amber) * (1 - usable / one.value)
    else:
        share = (one.value - good) / (usable - good) if math.isfinite(usable) else 1 - good / one.value
        place = green + (amber - green) * share
    zones = ((0, green, "good"), (green, amber, "usable"), (amber, WIDE, "inadequate"))
    drawn = "".join(
        f'<rect class="zone {name}" x="{a}%" width="{b - a}%" y="8" height="6"/>'
        for a, b, name in zones
        if b > a
    )
    at = min(97.0, max(3.0, place))
    return f'<svg aria-hidden="true">{drawn}<circle class="{kind}" cx="{at:.1f}%" cy="11" r="6"/></svg>'

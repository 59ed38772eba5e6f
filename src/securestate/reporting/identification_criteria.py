"""Why a model has its grade: every number the grade rests on, on a gauge of good, usable and inadequate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING

from securestate.identification import verdict as limits
from securestate.reporting.comparison_tables import rate, scroll
from securestate.reporting.page import compact, table

if TYPE_CHECKING:
    from securestate.identification.verdict import Criterion

WIDE, GOOD_END, USABLE_END = 100, 50, 80
"""Of a gauge: where it ends, where good ends, where usable ends."""


def why(found: Sequence[Criterion]) -> str:
    """Every number the grade rests on, on a gauge of good, usable and inadequate."""
    head = ("What is looked at", "Good, usable, inadequate", "Here", "Good", "Usable")
    drawn = table(head, map(_criterion, found))
    return scroll(drawn.replace("<table>", '<table class="gauges">', 1), "Why this grade")


def _criterion(one: Criterion) -> str:
    kind = str(one.grade)
    good, usable = _ranges(one)
    return (
        f'<tr><th scope="row">{escape(one.name)}</th><td class="gauge">{_gauge(one, kind)}</td>'
        f'<td class="{kind}">{_shown(one)}</td><td>{good}</td><td>{usable}</td></tr>'
    )


def _shown(one: Criterion) -> str:
    """The number, with the channel it belongs to."""
    if one.unit == "%":
        return f"{rate(one.shown)}, {escape(one.channel)}" if one.channel else rate(one.shown)
    if one.shown == 0 and not one.channel and one.ideal == 0:
        return "none beyond chance"
    number = compact(one.shown) if one.ideal else f"{one.shown:.2f} {one.unit}".rstrip()
    return f"{number}, {escape(one.channel)}" if one.channel else number


def _ranges(one: Criterion) -> tuple[str, str]:
    """Which numbers are good, and which are usable; empty if there are none in between."""
    least, most = limits.TOO_SMALL, limits.TOO_LARGE
    if one.limits in (least, most):
        return (
            f"{1 / least.usable:.2f} to {most.usable:.2f}",
            f"{1 / least.inadequate:.2f} to {most.inadequate:.2f}",
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

"""The mean squared error over time as a small drawing, one line per estimator, each labelled at its end."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from securestate.reporting.page import compact

Float = NDArray[np.float64]

WIDTH, HEIGHT = 520, 240
LEFT, RIGHT, TOP, BOTTOM = 44, 396, 12, 208
POINTS = 120
"""Longer curves are averaged down to so many points."""

SPAN = 6.0
"""At most so many decades are drawn; what lies above is drawn at the upper edge."""

COLOURS = 7
GAP = 14.0
"""Pixels between labels."""


def chart(curves: Mapping[str, Float], scored_from: int, title: str, attack_from: int | None = None) -> str:
    """One drawing as SVG; the first curve is the oracle's, dashed.

    Args:
        curves: squared error of every sample by estimator, (T,), all of one length; empty if it cannot run,
            so that an estimator has the same colour in all drawings.
        scored_from: first sample that counts, marked if it is not the first.
        title: read to those who cannot see the drawing.
        attack_from: first sample under attack, marked if scoring does not start there; None: nobody lies.
    """
    steps = max(curve.size for curve in curves.values())
    kinds = {name: _kind(i) for i, name in enumerate(curves)}
    reduced = {name: _reduce(curve) for name, curve in curves.items() if curve.size}
    low, high = _limits(reduced)
    heights = {name: _height(values, low, high) for name, values in reduced.items()}
    lines = "".join(_line(y, kinds[name], steps) for name, y in heights.items())
    labels = _labels({name: float(y[-1]) for name, y in heights.items()}, kinds)
    return (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(title)}">'
        f"{_grid(low, high)}{_time(steps)}{_marks(steps, scored_from, attack_from)}{lines}{labels}</svg>"
    )


def _reduce(curve: Float) -> Float:
    edges = _edges(curve.size, min(POINTS, curve.size))
    return np.array([curve[a:b].mean() for a, b in pairwise(edges)])


def _edges(steps: int, parts: int) -> NDArray[np.int64]:
    """Where parts begin that share the samples as evenly as can be, and the end, (parts + 1,)."""
    return np.arange(parts + 1) * steps // parts


def _limits(curves: Mapping[str, Float]) -> tuple[int, int]:
    """Powers of ten that hold what is finite, `SPAN` decades at most."""
    values = np.concatenate(list(curves.values()))
    values = values[np.isfinite(values) & (values > 0)]
    if not values.size:
        return 0, 1
    low = int(np.floor(np.log10(values.min())))
    high = int(np.ceil(min(np.log10(values.max()), low + SPAN)))
    return low, max(high, low + 1)


def _height(values: Float, low: int, high: int) -> Float:
    """Where values stand, in pixels from the top."""
    with np.errstate(divide="ignore"):
        share = (np.clip(np.log10(values), low, high) - low) / (high - low)
    height: Float = BOTTOM - share * (BOTTOM - TOP)
    return height


def _line(y: Float, kind: str, steps: int) -> str:
    """One line; its points stand in the middle of the samples they average."""
    edges = _edges(steps, y.size)
    x = LEFT + (edges[:-1] + edges[1:] - 1) / 2 / max(steps - 1, 1) * (RIGHT - LEFT)
    points = " ".join(f"{a:.0f},{b:.1f}" for a, b in zip(x, y, strict=True))
    return f'<polyline class="{kind}" points="{points}"/>'


def _kind(number: int) -> str:
    return f"line c{1 + (number - 1) % COLOURS}" if number else "line oracle"


def _labels(ends: Mapping[str, float], kinds: Mapping[str, str]) -> str:
    """Names beside the ends of their lines, pushed apart where they would overlap."""
    order = sorted(ends, key=lambda name: ends[name])
    places = np.array([ends[name] for name in order])
    for i in range(1, places.size):
        places[i] = max(places[i], places[i - 1] + GAP)
    for i in range(places.size - 1, -1, -1):
        limit = BOTTOM if i == places.size - 1 else places[i + 1] - GAP
        places[i] = min(places[i], limit)
    return "".join(
        f'<line class="{kinds[name]}" x1="{RIGHT + 4}" y1="{y:.1f}" x2="{RIGHT + 18}" y2="{y:.1f}"/>'
        f'<text x="{RIGHT + 22}" y="{y + 4:.1f}">{escape(_short(name))}</text>'
        for name, y in zip(order, places, strict=True)
    )


def _short(name: str) -> str:
    return name if len(name) <= 15 else f"{name[:14]}…"


def _grid(low: int, high: int) -> str:
    """A line for every power of ten, or every second or third one."""
    step = -(-(high - low) // 4)
    rows = []
    for power in range(low, high + 1, step):
        y = BOTTOM - (power - low) / (high - low) * (BOTTOM - TOP)
        rows.append(
            f'<line class="grid" x1="{LEFT}" y1="{y:.1f}" x2="{RIGHT}" y2="{y:.1f}"/>'
            f'<text x="{LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{_power(power)}</text>'
        )
    return "".join(rows)


def _power(power: int) -> str:
    return f"{10.0**power:g}" if -3 <= power <= 3 else compact(10.0**power)


def _time(steps: int) -> str:
    """Samples along the lower edge."""
    return (
        f'<text x="{LEFT}" y="{BOTTOM + 18}">0</text>'
        f'<text x="{RIGHT}" y="{BOTTOM + 18}" text-anchor="end">sample {steps - 1}</text>'
    )


def _marks(steps: int, scored_from: int, attack_from: int | None) -> str:
    """Where scoring and the attack start, if not at the first sample; one mark if at the same."""
    if attack_from == scored_from:
        return _mark(steps, scored_from, f"attack and scores from {scored_from}", 0) if scored_from else ""
    scores = _mark(steps, scored_from, f"scored from {scored_from}", 0) if scored_from else ""
    return scores + (_mark(steps, attack_from, f"attack from {attack_from}", 1) if attack_from else "")


def _mark(steps: int, sample: int, text: str, row: int) -> str:
    x = LEFT + sample / max(steps - 1, 1) * (RIGHT - LEFT)
    side, anchor = (4, "start") if x < (LEFT + RIGHT) / 2 else (-4, "end")
    place = f'x="{x + side:.0f}" y="{TOP + 8 + 14 * row}" text-anchor="{anchor}"'
    return (
        f'<line class="mark" x1="{x:.0f}" y1="{TOP}" x2="{x:.0f}" y2="{BOTTOM}"/>'
        f'<text class="mark" {place}>{text}</text>'
    )

"""The drawings of an identification's report: errors over time, how large they are, the orders tried.

SVG without a script. Across, everything stands in per cent of the drawing's width, so that text and dots keep
their size on any screen.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import special

from securestate.reporting.page import compact

if TYPE_CHECKING:
    from securestate.identification.order import OrderSearch
    from securestate.identification.residuals import Residuals

Float = NDArray[np.float64]

HEIGHT, TOP, FOOT = 240, 12, 26
"""Of a drawing in pixels, above what is drawn, and below it for the numbers of the axis."""

DOTS, STEPS = 800, 30
"""At most about so many dots, and so many means of longer stretches, over the whole record."""

SHORTEST = 10
"""Samples of such a stretch at least."""

APART = 60
"""Up to so many segments are drawn apart; more are drawn as one."""

BARS, CURVE = 26, 90
"""Bars of the histogram, and points of the curve over it."""


@dataclass(frozen=True, eq=False)
class Means:
    """Errors averaged over stretches of samples, none of which straddles a segment.

    Attributes:
        first, last: sample numbers, last not included.
        value: normalised innovation squared per reading, 1 if errors are as large as the model says.
        readings: how many are in it.
    """

    first: NDArray[np.int64]
    last: NDArray[np.int64]
    value: Float
    readings: Float

    @property
    def band(self) -> tuple[Float, Float]:
        """Where 95 of 100 such means lie if the model is right: chi-square over its degrees of freedom."""
        n = np.maximum(self.readings, 1.0)
        return special.chdtri(n, 0.975) / n, special.chdtri(n, 0.025) / n


def lengths(found: Residuals) -> list[int]:
    """Samples judged per segment; one number if they cannot be drawn apart."""
    read = [int(np.isfinite(part).any(axis=1).sum()) for part in found.segments]
    parts = [part for part in read if part]
    return parts if len(parts) <= APART and sum(parts) == found.samples else [found.samples]


def means(found: Residuals, length: int) -> Means:
    """Means over stretches of about so many samples."""
    edges = [0]
    for part in lengths(found):
        pieces = max(1, round(part / length))
        edges += [edges[-1] + part * (i + 1) // pieces for i in range(pieces)]
    bounds = np.array(edges)
    total = np.add.reduceat(found.nis, bounds[:-1])
    readings = np.add.reduceat(found.channels, bounds[:-1]).astype(np.float64)
    return Means(bounds[:-1], bounds[1:], total / np.maximum(readings, 1.0), readings)


def dots(found: Residuals) -> Means:
    """What is drawn as dots: every sample, or means over a few."""
    return means(found, max(1, -(-found.samples // DOTS)))


def stretches(found: Residuals) -> Means:
    """What is drawn as a line: means over longer stretches."""
    return means(found, max(SHORTEST, found.samples // STEPS))


@dataclass(frozen=True)
class Scale:
    """From numbers to places: per cent from the left, pixels from the top."""

    left: float
    right: float
    low: float
    high: float

    def x(self, value: float) -> str:
        """Per cent from the left."""
        return f"{100 * (value - self.left) / (self.right - self.left):.2f}%"

    def y(self, value: float) -> str:
        """Pixels from the top; what is too large or small stands at the edge."""
        share = min(1.0, max(0.0, (value - self.low) / (self.high - self.low)))
        return f"{HEIGHT - FOOT - share * (HEIGHT - FOOT - TOP):.1f}"


def over_time(found: Residuals) -> str:
    """Errors over the record judged: dots, means of longer stretches, and the band of 95 %."""
    small, large = dots(found), stretches(found)
    low, high = (float(np.median(edge)) for edge in small.band)
    scale = Scale(0, found.samples, 0.0, _top(small.value, high))
    worst = int(np.argmax(large.value))
    title = (
        f"Errors over {found.samples:,} samples: {compact(found.size)} times what the model says on average, "
        f"from {compact(float(large.value.min()))} to {compact(float(large.value[worst]))} in its stretches"
    )
    band = (
        f'<rect class="band" x="0" width="100%" y="{scale.y(high)}" '
        f'height="{float(scale.y(low)) - float(scale.y(high)):.1f}"/>'
        f'<line class="one" x1="0" x2="100%" y1="{scale.y(1)}" y2="{scale.y(1)}"/>'
    )
    inside = "".join(
        [_across(scale), band, _segments(found, scale), *_dots(small, scale), *_steps(large, scale)]
    )
    return _plot(title, scale, inside + _foot(found.samples))


def beyond(found: Residuals) -> int:
    """How many dots lie above the drawing."""
    small = dots(found)
    return int(np.sum(small.value > _top(small.value, float(np.median(small.band[1])))))


def _top(values: Float, band: float) -> float:
    """The upper end of the scale: holds the band and nearly all values."""
    usual = float(np.quantile(values, 0.98))
    return max(1.35 * band, min(1.05 * float(values.max()), 2.2 * usual))


def _dots(small: Means, scale: Scale) -> Iterator[str]:
    low, high = small.band
    for a, b, value, least, most in zip(small.first, small.last, small.value, low, high, strict=True):
        kind = " out" if value > most else " low" if value < least else ""
        place = f'cx="{scale.x((a + b) / 2)}" cy="{scale.y(value)}"'
        yield f'<circle class="dot{kind}" {place} r="2"/>'


def _steps(large: Means, scale: Scale) -> Iterator[str]:
    for a, b, value in zip(large.first, large.last, large.value, strict=True):
        y = scale.y(value)
        yield (
            f'<line class="step" x1="{scale.x(a)}" x2="{scale.x(b)}" y1="{y}" y2="{y}">'
            f"<title>samples {a:,} to {b - 1:,}: {compact(float(value))}</title></line>"
        )


def _segments(found: Residuals, scale: Scale) -> str:
    edges = np.cumsum(lengths(found))[:-1]
    return "".join(
        f'<line class="cut" x1="{scale.x(e)}" x2="{scale.x(e)}" y1="{TOP}" y2="{HEIGHT - FOOT}"/>'
        for e in edges.tolist()
    )


def _foot(samples: int) -> str:
    y = HEIGHT - 8
    middle = f'<text x="50%" y="{y}" text-anchor="middle">samples judged</text>'
    return f'<text x="0" y="{y}">0</text>{middle}<text x="100%" y="{y}" text-anchor="end">{samples:,}</text>'


def spread(found: Residuals) -> str:
    """How many samples have errors of which size, and how many should."""
    value = found.nis / np.maximum(found.channels, 1)
    usual = float(np.median(found.channels))
    top = _top(value, float(special.chdtri(usual, 0.01)) / usual)
    number = np.histogram(np.minimum(value, top * (1 - 1e-9)), BARS, (0.0, top))[0]
    curve = _expected(found, top, CURVE) * CURVE / BARS
    scale = Scale(0, top, 0, 1.08 * max(float(number.max()), float(curve.max())))
    points = [((i + 0.5) * top / CURVE, height) for i, height in enumerate(curve.tolist())]
    title = f"How many of {found.samples:,} samples have errors of which size; a perfect model's peak near 1"
    one = f'<line class="one" x1="{scale.x(1)}" x2="{scale.x(1)}" y1="{TOP}" y2="{HEIGHT - FOOT}"/>'
    bars = "".join(_bars(number, _expected(found, top, BARS), scale))
    line = _line(points, scale, "expected")
    return _drawing(title, f"{_level(HEIGHT - FOOT)}{bars}{line}{one}{_sizes(scale)}")


def _expected(found: Residuals, top: float, parts: int) -> Float:
    """Samples per part of 0 to `top` if the model is right: chi-square, by the channels that were read."""
    edges = np.arange(parts + 1) * (top / parts)
    below = np.zeros(parts + 1)
    for channels, samples in zip(*np.unique(found.channels, return_counts=True), strict=True):
        below += samples * special.chdtr(float(channels), channels * edges)
    return np.diff(below)


def _bars(number: NDArray[np.int64], expected: Float, scale: Scale) -> Iterator[str]:
    """The last bar holds all that is larger, too."""
    wide = scale.right / BARS
    for i, n in enumerate(number.tolist()):
        last = i == BARS - 1
        of = f"{i * wide:.2f} and more" if last else f"{i * wide:.2f} to {(i + 1) * wide:.2f}"
        e = float(number.sum() - expected[:-1].sum() if last else expected[i])
        place = f'x="{scale.x(i * wide)}" width="{100 / BARS - 0.4:.2f}%" y="{scale.y(n)}"'
        yield (
            f'<rect class="bar" {place} height="{HEIGHT - FOOT - float(scale.y(n)):.1f}">'
            f"<title>{of}: {n:,} samples, expected {e:.1f}</title></rect>"
        )


def _sizes(scale: Scale) -> str:
    """The numbers of the axis."""
    ticks = [tick for tick in _nice(0, scale.right, 4) if tick < 0.97 * scale.right]
    return "".join(
        f'<text x="{scale.x(tick)}" y="{HEIGHT - 8}" text-anchor="{"middle" if tick else "start"}">'
        f"{_number(tick)}</text>"
        for tick in ticks
    )


def orders(search: OrderSearch) -> str:
    """Log-likelihood of samples kept back by the number of states, of both forms, the chosen one marked."""
    curves = {"free": _finite(search.innovations), "own": _finite(search.independent)}
    values = [value for curve in curves.values() for value in curve.values()]
    most = max(n for curve in curves.values() for n in curve)
    low, high = min(values), max(values)
    room = 0.06 * max(high - low, 1e-9)
    scale = Scale(0.5, most + 0.5, low - room, high + room)
    chosen = scale.x(search.order)
    side = "end" if search.order > 0.6 * most else "start"
    at = scale.x(search.order + (-0.25 if side == "end" else 0.25))
    mark = (
        f'<line class="chosen" x1="{chosen}" x2="{chosen}" y1="{TOP}" y2="{HEIGHT - FOOT}"/>'
        f'<text class="chosen" x="{at}" y="{HEIGHT - FOOT - 8}" text-anchor="{side}">'
        f"chosen: {search.order}</text>"
    )
    lines = "".join(_curve(curve, scale, kind, search.order) for kind, curve in curves.items())
    step = max(1, -(-most // 12))
    numbers = "".join(
        f'<text x="{scale.x(n)}" y="{HEIGHT - 8}" text-anchor="middle">{n}</text>'
        for n in range(1, most + 1)
        if n == 1 or n % step == 0
    )
    title = f"Log-likelihood of samples kept back by number of states; {search.order} chosen"
    return _plot(title, scale, f"{_across(scale)}{mark}{lines}{numbers}")


def _finite(curve: Mapping[int, float]) -> dict[int, float]:
    return {n: value for n, value in curve.items() if np.isfinite(value)}


def _curve(curve: Mapping[int, float], scale: Scale, kind: str, chosen: int) -> str:
    name = {"free": "innovations form", "own": "independent noises"}[kind]
    points = sorted(curve.items())
    marks = "".join(
        f'<circle class="{kind}{" picked" if kind == "own" and n == chosen else ""}" cx="{scale.x(n)}" '
        f'cy="{scale.y(value)}" r="{6 if kind == "own" and n == chosen else 3.5}">'
        f"<title>{n} states, {name}: {value:.3f} nats per sample</title></circle>"
        for n, value in points
    )
    return _line(points, scale, kind) + marks


def _line(points: Sequence[tuple[float, float]], scale: Scale, kind: str) -> str:
    return "".join(
        f'<line class="{kind}" x1="{scale.x(a)}" y1="{scale.y(v)}" x2="{scale.x(b)}" y2="{scale.y(w)}"/>'
        for (a, v), (b, w) in pairwise(points)
    )


def _plot(title: str, scale: Scale, inside: str) -> str:
    """A drawing with the numbers of its vertical axis at the left."""
    labels = "".join(
        f'<text x="100%" y="{float(scale.y(tick)) + 4:.1f}" text-anchor="end">{_number(tick)}</text>'
        for tick in _nice(scale.low, scale.high, 5)
    )
    axis = f'<svg class="axis" aria-hidden="true">{labels}</svg>'
    return f'<div class="plot">{axis}{_drawing(title, inside)}</div>'


def _number(value: float) -> str:
    return (f"{value:g}" if abs(value) < 1e5 else compact(value)).replace("-", "−")


def _drawing(title: str, inside: str) -> str:
    return f'<svg class="drawing" role="img" aria-label="{escape(title)}">{inside}</svg>'


def _across(scale: Scale) -> str:
    return "".join(_level(float(scale.y(tick))) for tick in _nice(scale.low, scale.high, 5))


def _level(y: float) -> str:
    return f'<line class="grid" x1="0" x2="100%" y1="{y:.1f}" y2="{y:.1f}"/>'


def _nice(low: float, high: float, most: int) -> Iterable[float]:
    """Round numbers between two, about so many.

    Examples:
        >>> list(_nice(0, 2.7, 5)), list(_nice(-31.2, -24.9, 4))
        ([0.0, 1.0, 2.0], [-30.0, -28.0, -26.0])
    """
    rough = (high - low) / most
    size = 10.0 ** np.floor(np.log10(rough))
    step = float(next(s for s in (1 * size, 2 * size, 5 * size, 10 * size) if s >= rough))
    first = int(np.ceil(low / step - 1e-9))
    return [round(k * step, 12) for k in range(first, int(np.floor(high / step + 1e-9)) + 1)]

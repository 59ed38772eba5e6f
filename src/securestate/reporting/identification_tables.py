"""The tables of an identification's report: who can be checked, what repeats, and every sensor."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from html import escape
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from securestate._words import count
from securestate.identification import verdict as limits
from securestate.reporting.comparison_tables import scroll
from securestate.reporting.page import compact, table

if TYPE_CHECKING:
    from securestate.identification import Identified, SensorEvidence
    from securestate.identification.residuals import Residuals
    from securestate.plant import Plant

Float = NDArray[np.float64]
Draw = Callable[[Iterable[str]], str]

SHOWN = 40
"""At most so many sensors or channels stand open in a table; the others are folded away."""

SHADES = (0.05, 0.1, 0.2, 0.4)
"""Upper ends of the colours of autocorrelations; below the first, or within chance, there is none."""

UNLIKELY = 0.001
"""A p-value below this stands out."""


def checked(found: Identified) -> str:
    """One bar per sensor: how much of its variation the others explain; those that can be checked first."""
    order = sorted(found.verdict.sensors, key=lambda s: (not s.verifiable, -_or_zero(s.explained_least)))
    rows = [_bar(one, found) for one in order]
    unable = sum(not one.verifiable for one in order[SHOWN:])
    return _folded(rows, _bars, "sensor", f", {unable:,} of which cannot be checked" if unable else "")


def _bars(rows: Iterable[str]) -> str:
    axis = '<span class="scale"><span>0 %</span><span>50 %</span><span>100 %</span></span>'
    drawn = table(("Sensor", axis, "Explained", "At least", ""), rows)
    return scroll(drawn.replace("<table>", '<table class="bars">', 1), "Who can be checked")


def _bar(one: SensorEvidence, found: Identified) -> str:
    share, least = _or_zero(one.explained), _or_zero(one.explained_least)
    tick = (
        f'<line class="least" x1="{100 * least:.2f}%" x2="{100 * least:.2f}%" y1="3" y2="23"/>'
        if least
        else ""
    )
    drawn = (
        f'<svg aria-hidden="true"><rect class="track" width="100%" y="6" height="14"/>'
        f'<rect class="maybe" width="{100 * share:.2f}%" y="6" height="14"/>'
        f'<rect class="sure" width="{100 * least:.2f}%" y="6" height="14"/>'
        f'<line class="half" x1="50%" x2="50%" y1="0" y2="26"/>{tick}</svg>'
    )
    said = "can be checked" if one.verifiable else "cannot be checked"
    return (
        f'<tr class="{"checked" if one.verifiable else "unchecked"}">'
        f'<th scope="row">{escape(one.name)}{_tags(one, found)}</th><td class="bar">{drawn}</td>'
        f"<td>{portion(one.explained)}</td><td>{portion(one.explained_least)}</td><td>{said}</td></tr>"
    )


def _tags(one: SensorEvidence, found: Identified) -> str:
    plant = found.plant
    channels = len(plant.sensors[plant.sensor_names.index(one.name)].channels)
    told = f' <span class="tag">{channels} channels</span>' if channels > 1 else ""
    return told + (' <span class="tag far">suspect</span>' if one.name in found.verdict.blamed else "")


def _or_zero(share: float) -> float:
    return min(1.0, max(0.0, share)) if math.isfinite(share) else 0.0


def portion(share: float) -> str:
    """In whole per cent; a dash if it is not known.

    Examples:
        >>> [portion(s) for s in (0.523, 0.998, 0.9999, 1.0, -0.05, -0.001, float("nan"))]
        ['52 %', '99.8 %', '>99.9 %', '100 %', '0 %', '0 %', '–']
    """
    if math.isnan(share):
        return "–"
    if 0.99 < share < 1:
        return ">99.9 %" if share > 0.999 else f"{100 * share:.1f} %"
    return f"{100 * max(share, 0.0):.0f} %"


def repeated(found: Residuals) -> str:
    """Autocorrelation of every channel's errors by lag, coloured; of many channels the worst first."""
    order = list(range(len(found.names)))
    if len(order) > SHOWN:
        order = np.argsort(-np.nan_to_num(np.abs(found.repeat)).max(axis=0), kind="stable").tolist()
    rows = [_repeats(found, i, found.names[i]) for i in order]
    return _folded(rows, lambda some: _heat(some, len(found.repeat)), "channel")


def _heat(rows: Iterable[str], lags: int) -> str:
    drawn = table(("Channel", *(str(lag) for lag in range(1, lags + 1)), "Chance?"), rows)
    return scroll(drawn.replace("<table>", '<table class="heat">', 1), "Are errors white")


def _repeats(found: Residuals, i: int, name: str) -> str:
    error = 1 / math.sqrt(max(int(found.counted[i]), 1))
    cells = "".join(_cell(float(value), error) for value in found.repeat[:, i])
    return f'<tr><th scope="row">{escape(name)}</th>{cells}<td>{_p(float(found.ljung_box[i]))}</td></tr>'


def _cell(value: float, error: float) -> str:
    if math.isnan(value):
        return "<td>–</td>"
    mark = " certain" if abs(value) > limits.SURE * error else ""
    return f'<td class="{shade(value, error)}{mark}">{_signed(value)}</td>'


def shade(value: float, error: float) -> str:
    """The class of a cell's colour; none for what is small or within two standard errors.

    Examples:
        >>> [shade(v, 0.03) for v in (0.04, 0.055, -0.09, 0.15, -0.3, 0.9)]
        ['near', 'near', 'down1', 'up2', 'down3', 'up4']
    """
    level = int(np.searchsorted(SHADES, abs(value)))
    if level == 0 or abs(value) < 2 * error:
        return "near"
    return f"{'up' if value > 0 else 'down'}{level}"


def _p(value: float) -> str:
    return "–" if math.isnan(value) else "&lt;0.001" if value < UNLIKELY else f"{value:.3f}"


def _folded(rows: Sequence[str], draw: Draw, noun: str, note: str = "") -> str:
    """A table of the first rows, and the others behind a click."""
    if len(rows) <= SHOWN:
        return draw(rows)
    more = f"{count(len(rows) - SHOWN, f'more {noun}')}{note}"
    return f"{draw(rows[:SHOWN])}<details><summary>{more}</summary>{draw(rows[SHOWN:])}</details>"


def sensors(found: Identified) -> str:
    """Everything about every channel, in the plant's order; a sensor's channels stand together."""
    plant = found.plant
    named = plant.channel_names != plant.sensor_names
    head = (
        "Sensor",
        *(("Channel",) if named else ()),
        *(("Unit",) if any(plant.units) else ()),
        "Operating point",
        "Normal variation",
        "Noise σ",
        "Can be checked",
        "Explained",
        "Own noise",
        "Errors over claimed",
        "Repeat",
        "Ljung-Box p",
        "Shift, sd",
    )
    rows = [row for i, one in enumerate(found.verdict.sensors) for row in _sensor(found, i, one, named)]
    kind = "scroll tall" if plant.m > SHOWN else "scroll"
    drawn = table(head, rows).replace("<table>", '<table class="sensors">', 1)
    return scroll(drawn, "Sensors").replace('class="scroll"', f'class="{kind}"', 1)


def _sensor(found: Identified, i: int, one: SensorEvidence, named: bool) -> Iterator[str]:
    plant, judged = found.plant, found.verdict.residuals
    channels = range(plant.m)[plant.channels_of(i)]
    span = f' rowspan="{len(channels)}"' if len(channels) > 1 else ""
    scope = ' scope="rowgroup"' if len(channels) > 1 else ' scope="row"'
    verdict = '<span class="verdict yes">yes</span>' if one.verifiable else '<span class="soft">no</span>'
    for k in channels:
        first = k == channels[0]
        name = f"<th{scope}{span}>{escape(one.name)}{_tags(one, found)}</th>" if first else ""
        own = plant.channel_names[k] if len(channels) > 1 or plant.channel_names[k] != one.name else ""
        channel = f"<td>{escape(own)}</td>" if named else ""
        shared = (
            f"<td{span}>{verdict}</td><td{span}>{portion(one.explained)}</td><td{span}>{portion(one.noise)}</td>"
            if first
            else ""
        )
        numbers = _errors(judged, plant.channel_names[k])
        yield f"<tr>{name}{channel}{_engineering(plant, k)}{shared}{numbers}</tr>"


def _engineering(plant: Plant, k: int) -> str:
    scale = float(plant.scale[k])
    noise = math.sqrt(float(plant.R[k, k])) * scale
    unit = f"<td>{escape(plant.units[k])}</td>" if any(plant.units) else ""
    return (
        f"{unit}<td>{to_scale(float(plant.offset[k]), scale)}</td>"
        f"<td>{amount(scale)}</td><td>{amount(noise)}</td>"
    )


def _errors(found: Residuals, channel: str) -> str:
    """Numbers of a channel; none if another one that repeats it was judged in its place."""
    if channel not in found.names:
        return '<td class="soft">as above</td>' + 3 * "<td></td>"
    k = found.names.index(channel)
    variance, p = float(found.variance[k]), float(found.ljung_box[k])
    far = (variance > limits.TOO_LARGE.inadequate) or (
        1 / max(variance, 1e-300) > limits.TOO_SMALL.inadequate
    )
    cells = (
        (compact(variance), far),
        (_signed(float(found.repeat[0, k])), abs(found.repeat[0, k]) > limits.REPEATS_WORST.usable),
        (_p(p), p < UNLIKELY),
        (_signed(float(found.shift[k])), abs(found.shift[k]) > limits.SHIFT.usable),
    )
    return "".join(f'<td class="out">{text}</td>' if out else f"<td>{text}</td>" for text, out in cells)


def _signed(value: float) -> str:
    if math.isnan(value):
        return "–"
    text = f"{abs(value):.2f}"
    return f"−{text}" if value < 0 and text != "0.00" else text


def amount(value: float) -> str:
    """A positive number in three digits, without an exponent where it can be.

    Examples:
        >>> [amount(v) for v in (34.812, 0.0026, 12345.0, 1e-9, 0.0)]
        ['34.8', '0.00260', '12,345', '1e-9', '0']
    """
    return to_scale(value, value / 10) if 1e-5 <= value < 1e7 else compact(value)


def to_scale(value: float, scale: float) -> str:
    """A number with as many decimals as its normal variation needs.

    Examples:
        >>> to_scale(3662.1988, 33.9), to_scale(0.25055, 0.0301), to_scale(-2.5, 0.4), to_scale(-0.01, 4.0)
        ('3,662', '0.251', '−2.50', '0.0')
    """
    if abs(value) >= 1e7 or scale < 1e-7:
        return compact(value).replace("-", "−", 1) if value < 0 else compact(value)
    decimals = max(0, 1 - math.floor(math.log10(scale)))
    text = f"{abs(value):,.{decimals}f}"
    return f"−{text}" if value < 0 and text.strip("0.") else text

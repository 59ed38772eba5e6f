"""The picture of an installation: modes by sensors, who sees what, coloured by how strongly."""

from __future__ import annotations

from collections.abc import Iterable, Sequence, Set
from dataclasses import dataclass
from html import escape

import numpy as np
from numpy.typing import NDArray

from securestate._analysis_text import names
from securestate.plant import Plant
from securestate.reporting.page import percent, table
from securestate.resilience import Mode, Visibility

ROWS, COLUMNS = 24, 58
"""At most so many modes and sensors are shown."""

DENSE = 40
"""Above so many sensors the cells are smaller."""

IN_ORDER = 24
"""Up to so many sensors stand in the order of the plant; more by the weakest mode that they see."""

SHADES = (0.02, 0.08, 0.25, 0.5)
"""Upper ends of the colours."""

SHORT = 26
"""Longer names of sensors are cut above their column; pointing at one shows it whole."""

SAME = 1e-6
"""Modes whose eigenvalues, and cosines of directions, are this close are one."""


@dataclass(frozen=True, eq=False)
class Part:
    """What is shown of a matrix, as indices.

    Attributes:
        rows: modes, from top to bottom.
        columns: sensors, from left to right.
        involved: how many sensors see one of these modes.
    """

    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    involved: int


@dataclass(frozen=True, eq=False)
class Marks:
    """What stands out.

    Attributes:
        weakest: names of the sensors that see the first mode; None if no mode is the weakest.
        new: sensors that are new, or newly protected, as indices.
        before: for every mode what was seen and survived before, as text; None where it was not shown.
    """

    weakest: Set[str] | None = None
    new: Set[int] = frozenset()
    before: Sequence[tuple[str, str] | None] | None = None

    def hit(self, name: str) -> bool:
        """Whether a sensor sees the weakest mode."""
        return self.weakest is not None and name in self.weakest


def chosen(view: Visibility, rows: Iterable[int] | None = None) -> Part:
    """As many of the weakest modes and of the sensors that see them as can be read.

    Args:
        view: who sees what, weakest first.
        rows: the modes to choose from, from top to bottom; default all.
    """
    kept: list[int] = []
    columns: list[int] = []
    for row in range(len(view.modes)) if rows is None else rows:
        added = sorted(set(np.flatnonzero(view.sees[row]).tolist()) - set(columns))
        if kept and (len(kept) == ROWS or len(columns) + len(added) > COLUMNS):
            break
        loudest = sorted(added, key=lambda i: -view.share[row, i])
        columns += sorted(loudest[: max(0, COLUMNS - len(columns))])
        kept.append(row)
    sensors = view.sees.shape[1]
    if sensors <= IN_ORDER:
        columns = list(range(sensors))
    involved = int(view.sees[kept].any(axis=0).sum())
    return Part(np.array(kept, np.int64), np.array(columns, np.int64), involved)


def partners(before: Visibility, after: Visibility) -> list[int | None]:
    """For every mode of `after` the same one of `before`; None where it has no equal there."""
    directions = np.array([mode.direction for mode in before.modes])
    values = np.array([mode.eigenvalue for mode in before.modes])
    found: list[int | None] = []
    for mode in after.modes:
        near = np.abs(values - mode.eigenvalue) <= SAME * max(1.0, abs(mode.eigenvalue))
        cosine = np.where(near, np.abs(directions.conj() @ mode.direction), 0.0)
        best = int(np.argmax(cosine))
        found.append(best if cosine[best] >= 1 - SAME else None)
    return found


def seen_by(view: Visibility, row: int) -> str:
    """How many sensors see a mode; protected ones apart."""
    guards = int((view.sees[row] & view.protected).sum())
    return str(view.count[row]) + (f" + {guards} protected" if guards else "")


def survived(view: Visibility, row: int) -> str:
    """How many liars a mode survives, in words where it is no number."""
    if not view.sees[row].any():
        return "not seen"
    return "any" if (view.sees[row] & view.protected).any() else str(view.survives[row])


def matrix(plant: Plant, view: Visibility, part: Part, marks: Marks) -> str:
    """One row per mode: its name, how many see it, how many liars it survives; then sensor by sensor."""
    heads = "".join(_sensor(plant, int(i), marks) for i in part.columns)
    rows = "".join(_row(plant, view, int(row), part, marks) for row in part.rows)
    titles = (("corner", "Mode"), ("end", "Seen by"), ("end", "Survives"))
    corner = "".join(f'<th scope="col" class="{kind}">{title}</th>' for kind, title in titles)
    dense = " dense" if len(part.columns) > DENSE else ""
    return (
        f'<table class="matrix{dense}"><thead><tr>{corner}{heads}</tr></thead><tbody>{rows}</tbody></table>'
    )


def listing(plant: Plant, view: Visibility) -> str:
    """All modes as text, with the names of the sensors that see them."""
    rows = []
    for row, mode in enumerate(view.modes):
        loudest = np.argsort(-view.share[row], kind="stable")[: int(view.sees[row].sum())]
        seers = names([plant.sensor_names[i] for i in loudest])
        cells = (seen_by(view, row), survived(view, row))
        rows.append(
            f'<tr><th scope="row">{_mode(mode)}</th><td>{cells[0]}</td><td>{cells[1]}</td>'
            f'<td class="where">{escape(seers) or "none"}</td></tr>'
        )
    return table(("Mode", "Seen by", "Survives", "Sensors, the one that sees it best first"), rows)


def _sensor(plant: Plant, i: int, marks: Marks) -> str:
    name, guard = plant.sensor_names[i], bool(plant.protected[i])
    hit = marks.hit(name) and len(marks.weakest or ()) < plant.n_sensors  # where all do, none stands out
    flags = {"hit": hit, "new": i in marks.new, "guard": guard}
    kinds = [kind for kind, is_so in flags.items() if is_so]
    sign = ("+ " if i in marks.new else "") + ("◆ " if guard else "")
    told = name if len(name) <= SHORT else f"{name[: SHORT - 1].rstrip()}…"
    label = f"{escape(sign)}{escape(told)}"
    classes = " ".join(["sensor", *kinds])
    return f'<th scope="col" class="{classes}" title="{escape(name)}"><span>{label}</span></th>'


def _row(plant: Plant, view: Visibility, row: int, part: Part, marks: Marks) -> str:
    weak = row == 0 and marks.weakest is not None
    cells = "".join(
        _cell(plant, view, row, int(i), outlined=weak and marks.hit(plant.sensor_names[i]))
        for i in part.columns
    )
    fresh = marks.before is not None and marks.before[row] is None
    tags = (' <span class="tag far">weakest</span>' if weak else "") + (
        ' <span class="tag">not shown above</span>' if fresh else ""
    )
    mode = f'<th scope="row" title="{escape(str(view.modes[row]))}">{_mode(view.modes[row])}{tags}</th>'
    return f'<tr class="{"weak" if weak else ""}">{mode}{_ends(view, row, marks)}{cells}</tr>'


def _mode(mode: Mode) -> str:
    """A mode as a heading: its eigenvalue and the states that it moves most, cut where there are many."""
    value, _, states = str(mode).partition(" (")
    named = ", ".join(mode.states[:2]) + (f" and {len(mode.states) - 2} more" if len(mode.states) > 2 else "")
    return f"{escape(value)} <span>({escape(named)})</span>" if states else escape(value)


def _cell(plant: Plant, view: Visibility, row: int, i: int, *, outlined: bool) -> str:
    name = escape(plant.sensor_names[i])
    if not view.sees[row, i]:
        return f'<td class="blind" title="{name}: blind"></td>'
    share = float(view.share[row, i])
    kind = f"{shade(share)}{' hit' if outlined else ''}"
    return f'<td class="{kind}" title="{name}: {percent(share)}"></td>'


def shade(share: float) -> str:
    """The class of a cell's colour.

    Examples:
        >>> [shade(s) for s in (0.001, 0.02, 0.03, 0.5, 0.51, 1.0)]
        ['see0', 'see0', 'see1', 'see3', 'see4', 'see4']
    """
    return f"see{int(np.searchsorted(SHADES, share))}"


def _ends(view: Visibility, row: int, marks: Marks) -> str:
    now = (seen_by(view, row), survived(view, row))
    low = " low" if view.survives[row] <= 0 and now[1] != "any" else ""
    if marks.before is None:
        return f'<td class="end">{now[0]}</td><td class="end{low}">{now[1]}</td>'
    then = marks.before[row]
    return "".join(
        f'<td class="end{kind}">{_change(None if then is None else then[k], now[k])}</td>'
        for k, kind in enumerate(("", low))
    )


def _change(then: str | None, now: str) -> str:
    if then is None or then == now:
        return now
    return f'<span class="soft">{then} →</span> <b>{now}</b>'

"""The report of an installation: what it survives and what would help, as one HTML file without a script."""

from __future__ import annotations

import os
from collections.abc import Sequence
from html import escape
from importlib.metadata import version
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING

import numpy as np

from securestate._analysis_text import headline, names, remarks
from securestate._words import count
from securestate.reporting import resilience_tables as tables
from securestate.reporting.comparison_tables import scroll
from securestate.reporting.page import asset, paragraphs, write_page
from securestate.reporting.resilience_figures import (
    Marks,
    Part,
    chosen,
    listing,
    matrix,
    partners,
    seen_by,
    survived,
)
from securestate.reporting.resilience_tables import Improved
from securestate.resilience import Limit, Visibility, limit, visibility

if TYPE_CHECKING:
    from securestate.analysis import Resilience

AFTER = 20.0
"""Seconds for the limits after all options together; what is not settled by then is given as bounds."""


def write_resilience(
    resilience: Resilience,
    path: str | os.PathLike[str],
    *,
    title: str | None = None,
    source: str | os.PathLike[str] | None = None,
) -> Path:
    """Write an analysis as one HTML file that opens offline. Written whole or not at all.

    Args:
        resilience: what `analyse` returned.
        path: where to write; an existing file is replaced.
        title: default "Resilience report", with the plant's name.
        source: where the plant came from, shown as given.
    Returns:
        The path written.
    Raises:
        OSError: the file cannot be written; nothing is left behind.
    """
    return write_page(render(resilience, title=title, source=source), path)


def render(
    resilience: Resilience, *, title: str | None = None, source: str | os.PathLike[str] | None = None
) -> str:
    """The report as text; arguments as for `write_resilience`."""
    found = resilience
    improved = _improved(found)
    return Template(asset("resilience.html")).substitute(
        style=asset("page.css", "comparison.css", "resilience.css"),
        title=escape(title or f"Resilience report: {found.plant.name or ''}".removesuffix(": ")),
        tone="calm" if found.max_attacked >= 1 or (found.limit.unlimited and found.limit.upper) else "alarm",
        headline=escape(headline(found)),
        remarks=paragraphs(remarks(found)),
        facts=tables.facts(found, source),
        picture=_picture(found),
        help=_help(found, improved),
        after=_after(found, improved[0]) if improved else "",
        recommended=_recommended(found),
        estimators=tables.estimators(found),
        tolerances=tables.tolerances(found),
        version=escape(version("securestate")),
    )


def _improved(found: Resilience) -> list[Improved]:
    """The options, each with the limit after it."""
    share = AFTER / max(1, len(found.options))
    return [
        Improved(option, limit(option.plant, found.limit.cut, tol=found.limit.tol, time_limit=share))
        for option in found.options
    ]


def _picture(found: Resilience) -> str:
    """Who sees what."""
    part = chosen(found.view)
    drawn = scroll(matrix(found.plant, found.view, part, Marks(_weakest(found.limit))), "Who sees what")
    every = scroll(listing(found.plant, found.view), "All modes")
    return (
        f"{drawn}{_left_out(found.view, part)}"
        f"<details><summary>All modes, with the names of their sensors</summary>{every}</details>"
    )


def _weakest(found: Limit) -> frozenset[str] | None:
    """The sensors that decide the limit."""
    return None if found.weakest is None else frozenset(found.weakest.sensors)


def _left_out(view: Visibility, part: Part) -> str:
    """What the picture does not show."""
    modes, sensors = view.sees.shape
    if len(part.rows) == modes and len(part.columns) == sensors:
        return ""
    cut = len(part.rows) < modes
    told = [f"Shown: the {len(part.rows)} weakest of {modes:,} modes" if cut else "Shown: every mode"]
    if len(part.columns) < sensors:
        told.append(f"{len(part.columns)} of {count(sensors, 'sensor')}")
    hidden = part.involved - int(view.sees[np.ix_(part.rows, part.columns)].any(axis=0).sum())
    others = (
        f"; {hidden:,} more see one of these modes"
        if hidden > 0
        else "; the others see none of these modes"
        if len(part.columns) < sensors
        else ""
    )
    return f'<p class="hint below">{" and ".join(told)}{others}.</p>'


def _help(found: Resilience, improved: Sequence[Improved]) -> str:
    """What would help: the table of options and the smallest protection."""
    said = []
    if not improved:
        said.append(_no_option(found))
    if found.protection is not None and found.protection[0] and not found.limit.unlimited:
        chosen_names, fewest = found.protection
        sure = "no smaller set does" if fewest else "fewer may do"
        said.append(
            f"To survive any number of liars, protect {count(len(chosen_names), 'sensor')} ({sure}): "
            f"{names(chosen_names)}."
        )
    return tables.options(improved) + paragraphs(said)


def _no_option(found: Resilience) -> str:
    if found.limit.unlimited:
        return "Nothing has to change: it survives any number of liars."
    if found.max_attacked >= found.goal:
        return f"Nothing has to change to survive {count(found.goal, 'liar')}."
    return f"No change of few sensors was found that survives {count(found.goal, 'liar')}."


def _after(found: Resilience, first: Improved) -> str:
    """The same picture after the first option, with the numbers before and after."""
    plant, view = first.option.plant, visibility(first.limit)
    equal = partners(found.view, view)
    shown = set(chosen(found.view).rows.tolist())
    least = view.survives.min()
    rows = [row for row, old in enumerate(equal) if old in shown or view.survives[row] == least]
    before = [None if old is None else (seen_by(found.view, old), survived(found.view, old)) for old in equal]
    new = _new(found, first)
    marks = Marks(_weakest(first.limit), frozenset(new), before)
    part = chosen(view, rows)
    hidden = len(set(new) - set(part.columns.tolist()))
    more = f" Of what is new, {hidden:,} had no room." if hidden else ""
    what = f"{tables.KINDS[first.option.kind].lower()}: {tables.items(first.option)}"
    return (
        f"<h3>Before and after ({escape(what)})</h3>"
        '<p class="hint">The same picture after this change. What is new is marked +; numbers that change '
        f"are shown before → after.{more}</p>"
        f"{scroll(matrix(plant, view, part, marks), 'After the change')}{_left_out(view, part)}"
    )


def _new(found: Resilience, first: Improved) -> list[int]:
    """Sensors that the change adds or protects, as indices into the changed plant."""
    old, plant = found.plant, first.option.plant
    protected = dict(zip(old.sensor_names, old.protected.tolist(), strict=True))
    return [
        i
        for i, name in enumerate(plant.sensor_names)
        if name not in protected or bool(plant.protected[i]) != protected[name]
    ]


def _recommended(found: Resilience) -> str:
    if not found.method:
        return f"<p>None: {escape(found.why)}.</p>"
    method = escape(found.method)
    command = f"<code>securestate estimate <span>--method {method}</span></code>"
    return (
        f'<p>Use <b>{method}</b>: {escape(found.why)}.</p><p class="hint">On the command line: {command}</p>'
    )

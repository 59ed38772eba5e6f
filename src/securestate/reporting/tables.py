"""The tables of the report but that of the sensors, as HTML. Every name from a file is escaped here."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING

from securestate._words import count
from securestate.estimators.base import Status
from securestate.reporting.blocks import channel_noise
from securestate.reporting.clock import Clock, Moment
from securestate.reporting.page import definitions, table
from securestate.reporting.periods import meaning
from securestate.reporting.summary import Summary
from securestate.reporting.telling import stretch

if TYPE_CHECKING:
    from securestate.estimators.run import Run

STRETCHES = 8
"""So many stretches of a status are listed."""


def facts(run: Run, summary: Summary, clock: Clock, source: str | os.PathLike[str] | None) -> str:
    """What was run, as a definition list."""
    p = run.plant
    sizes = ((p.n, "state"), (p.n_sensors, "sensor"), (p.m, "channel"), (p.n_inputs, "input"))
    rows = {
        "Plant": summary.plant or "unnamed",
        "Data": "" if source is None else os.fspath(source),
        "Estimator": summary.estimator,
        "Samples": f"{summary.samples:,}",
        "Time": clock.span,
        "Size": ", ".join(count(*c) for c in sizes if c[0]),
    }
    return definitions(rows)


def unknown(summary: Summary) -> str:
    """What the colour of an unknown trust stands for."""
    return "sent nothing, or cannot be checked" if summary.caveat else "sent nothing"


def headline(summary: Summary) -> str:
    """The verdict; every name in it stays in one piece where the page is wide enough."""
    words = summary.verdict_with(_unbroken)
    return re.sub(r"</span>([,.])", r"\1</span>", words)


def _unbroken(name: str) -> str:
    r"""A name as one piece, and a number in it never apart from the word it numbers.

    Examples:
        >>> ascii(_unbroken("flow 11 <east>"))
        "'<span>flow\\xa011 &lt;east&gt;</span>'"
    """
    return f"<span>{escape(re.sub(r' (?=[0-9])', chr(0xA0), name))}</span>"


def statuses(summary: Summary, clock: Clock) -> str:
    """Counts, times and advice per status, and the solver's figures; room for a chart if any is not OK."""
    stretches = {p.status: p.stretches for p in summary.findings.periods}
    head = ("Status", "Samples", *(("When",) if stretches else ()), "What to do")
    rows = (
        (
            _key(s.name),
            f"{s.count:,}",
            *((_stretches(stretches.get(s.name, ()), clock),) if stretches else ()),
            escape(_sentence(meaning(Status[s.name]))),
        )
        for s in summary.statuses
    )
    chart = '<div class="plot"></div>' if stretches else ""
    return f"{plain_table(head, rows)}<p>{' '.join(_solver(summary))}</p>{chart}"


def _sentence(half: str) -> str:
    return f"{half[:1].upper()}{half[1:]}."


def _stretches(stretches: Sequence[tuple[Moment, Moment]], clock: Clock) -> str:
    """The first stretches, each a link, and how many more there are."""
    shown = [linked(escape(stretch(*ends, clock)), ends[0], clock) for ends in stretches[:STRETCHES]]
    more = len(stretches) - STRETCHES
    return "<br>".join([*shown, *([f"and {more:,} more"] if more > 0 else [])])


def _key(status: str) -> str:
    return f'<span class="key status-{status}"></span>{status}'


def _solver(summary: Summary) -> list[str]:
    lines = []
    if summary.fast_path is not None:
        lines.append(f"Fast path: {100 * summary.fast_path:.1f} % of samples needed no solver.")
    if summary.iterations is not None:
        who = "Samples" if summary.fast_path is None else "The others"
        lines.append(f"{who} took {summary.iterations:g} iterations in the median.")
    if summary.gap is not None:
        what = "change in a last iteration" if summary.fast_path is None else "relative duality gap"
        lines.append(f"Worst {what}: {summary.gap:.1e}.")
    return lines


def plant(run: Run) -> str:
    """Sensors with units, operating point and noise; inputs; settings of the estimator."""
    p = run.plant
    noise = channel_noise(p)
    marks = ("Protected",) if p.verifiable.all() else ("Protected", "Verifiable")
    head = ("Channel", "Sensor", "Unit", "Operating point", "Scale", "Noise (σ)", *marks)
    rows = (
        (
            escape(p.channel_names[c]),
            escape(p.sensor_names[owner]),
            escape(p.units[c]),
            f"{p.offset[c]:.6g}",
            f"{p.scale[c]:.6g}",
            f"{noise[c]:.3g}",
            "yes" if p.protected[owner] else "",
            *(() if p.verifiable.all() else ("yes" if p.verifiable[owner] else "no",)),
        )
        for c, owner in enumerate(p.channel_sensor)
    )
    return (
        f"<h3>Settings</h3>{plain_table(('Setting', 'Value'), _settings(run))}"
        f"<h3>Channels</h3>{plain_table(head, rows)}"
    )


def _settings(run: Run) -> Iterable[tuple[str, str]]:
    p = run.plant
    yield "estimator", escape(run.estimator)
    for name, value in run.settings.items():
        yield escape(name.replace("_", " ")), escape(str(value))
    yield "sample time", f"{p.dt:g}"
    yield "time varying", "yes" if p.time_varying else "no"
    yield "states", escape(", ".join(p.state_names))
    if p.n_inputs:
        yield "inputs", escape(", ".join(p.input_names))


def plain_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of cells that are HTML already."""
    return table(head, [row(head, cells) for cells in rows])


def row(head: Sequence[str], cells: Sequence[str], kind: str = "") -> str:
    """A row; on a phone every cell carries its heading, and empty cells are left out."""
    columns = (
        f'<td data-label="{h}">{c}</td>' if c else f'<td data-label="{h}" class="empty">–</td>'
        for h, c in zip(head, cells, strict=True)
    )
    return f'<tr class="{kind}">{"".join(columns)}</tr>'


def moment(at: Moment, clock: Clock) -> str:
    """A time as a link that shows it in the charts."""
    return f'<button class="go" data-sample="{at.index}">{escape(clock.text(at.index))}</button>'


def linked(told: str, at: Moment, clock: Clock) -> str:
    """A sentence, HTML already, with the first mention of a time as a link."""
    return told.replace(escape(clock.text(at.index)), moment(at, clock), 1)

"""The tables of the report, as HTML. Every name from a file is escaped here."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING

from securestate._words import count
from securestate.reporting.blocks import channel_noise
from securestate.reporting.clock import Clock, Moment
from securestate.reporting.page import definitions, percent, table
from securestate.reporting.summary import SensorSummary, Summary
from securestate.reporting.telling import measured

if TYPE_CHECKING:
    from securestate.estimators.run import Run

HEAD = ("Sensor", "Verdict", "Suspected", "Lies since", "First alarm", "Estimated injection", "Missing")


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


def sensors(summary: Summary, clock: Clock) -> str:
    """A table of the sensors there is something to say about, liars first; the others are listed below it."""
    ranked = sorted(summary.sensors, key=lambda s: (not s.lies, s.missing < 1.0, -s.suspected, -s.missing))
    told = [s for s in ranked if s.first_alarm is not None or s.missing > 0 or s.uncheckable]
    quiet = [s for s in ranked if s not in told]
    return _notable(told, clock) + _quiet(quiet, everyone=not told)


def _notable(told: Sequence[SensorSummary], clock: Clock) -> str:
    """One row per sensor, without the columns in which nobody has an entry."""
    cells = [_sensor_cells(s, clock) for s in told]
    used = [k for k in range(len(HEAD)) if any(row[k] for row in cells)]
    head = [HEAD[k] for k in used]
    rows = [
        _row(head, [row[k] for k in used], "liar" if s.lies else "")
        for s, row in zip(told, cells, strict=True)
    ]
    return table(head, rows) if rows else ""


def _quiet(quiet: Sequence[SensorSummary], *, everyone: bool) -> str:
    if not quiet:
        return ""
    label = f"No alarm from {'any sensor' if everyone else count(len(quiet), 'other sensor')}"
    ends = [","] * (len(quiet) - 1) + ["."]
    names = " ".join(f"<span>{_name(s)}{end}</span>" for s, end in zip(quiet, ends, strict=True))
    return f'<p class="quiet"><b>{label}:</b> {names}</p>'


def _name(s: SensorSummary) -> str:
    alone = "cannot be checked" if s.uncheckable and s.first_alarm else ""
    tag = "protected" if s.protected else alone
    return escape(s.name) + (f' <span class="tag">{tag}</span>' if tag else "")


def _sensor_cells(s: SensorSummary, clock: Clock) -> tuple[str, ...]:
    return (
        _name(s),
        f'<span class="verdict-{_verdict(s).replace(" ", "-")}">{_verdict(s)}</span>',
        _share(s.suspected),
        _moment(s.since, clock),
        _moment(s.first_alarm, clock),
        "<br>".join(_known_injections(s)),
        _share(s.missing),
    )


def _verdict(s: SensorSummary) -> str:
    if s.lies:
        return "lies"
    if s.missing == 1.0:
        return "no data"
    if s.first_alarm is not None:
        return "isolated alarms"
    return "cannot be checked" if s.uncheckable else "no alarm"


def _moment(moment: Moment | None, clock: Clock) -> str:
    if moment is None:
        return ""
    return f'<button class="go" data-sample="{moment.index}">{escape(clock.text(moment.index))}</button>'


def _share(share: float) -> str:
    return percent(share) if share else ""


def _known_injections(s: SensorSummary) -> Iterable[str]:
    """One line per channel that has an estimate; the channel is named if there are several."""
    for i in s.injections:
        if not math.isnan(i.median):
            text = f"{measured(i.median, i.spread)} {i.unit}".strip()
            yield escape(f"{i.channel}: {text}" if len(s.injections) > 1 else text)


def statuses(summary: Summary) -> str:
    """Counts and advice per status, and the solver's figures; room for a chart if any is not OK."""
    head = ("Status", "Samples", "What to do")
    rows = ((_key(s.name), f"{s.count:,}", escape(s.advice)) for s in summary.statuses)
    chart = "" if all(s.name == "OK" for s in summary.statuses) else '<div class="plot"></div>'
    return f"{_plain_table(head, rows)}<p>{' '.join(_solver(summary))}</p>{chart}"


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
        f"<h3>Settings</h3>{_plain_table(('Setting', 'Value'), _settings(run))}"
        f"<h3>Channels</h3>{_plain_table(head, rows)}"
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


def _plain_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    return table(head, [_row(head, cells) for cells in rows])


def _row(head: Sequence[str], cells: Sequence[str], kind: str = "") -> str:
    """A row; on a phone every cell carries its heading, and empty cells are left out."""
    columns = (
        f'<td data-label="{h}">{c}</td>' if c else f'<td data-label="{h}" class="empty">–</td>'
        for h, c in zip(head, cells, strict=True)
    )
    return f'<tr class="{kind}">{"".join(columns)}</tr>'

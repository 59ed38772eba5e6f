"""Findings as HTML: the sentences at the head of the report, and the table of the sensors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

from securestate._words import count
from securestate.reporting.clock import Clock
from securestate.reporting.courses import Course, Kind
from securestate.reporting.findings import Finding
from securestate.reporting.page import percent, table
from securestate.reporting.summary import SensorSummary, Summary
from securestate.reporting.tables import linked, moment, row
from securestate.reporting.telling import crowded, plain, remarks, rounded, typical, what

HEAD = (
    "Sensor",
    "Verdict",
    "From",
    "Until",
    "Estimated injection",
    "Course",
    "Suspected",
    "Trust",
    "Missing",
)

KINDS = ("No data", "Isolated alarms", "Cannot be checked", "No alarm")
"""What may be said of a sensor without a finding."""

TOLD = 6
"""Findings that the head of the page tells."""


def sentences(summary: Summary, clock: Clock) -> str:
    """What was found, as a list: the largest and surest first, then what is no finding."""
    findings = summary.findings
    told = [f for f in findings.found if not f.together]
    items = [linked(escape(crowded(c, clock)), c.since, clock) for c in findings.crowds[:TOLD]]
    items += [_sentence(f, clock) for f in told[:TOLD]]
    if len(told) > TOLD:
        items.append(f"{count(len(told) - TOLD, 'more finding')} in the table, smaller or less certain.")
    items += map(escape, remarks(findings.alarms))
    return f'<ul class="findings">{"".join(f"<li>{item}</li>" for item in items)}</ul>' if items else ""


def sensors(summary: Summary, clock: Clock) -> str:
    """A table with a row per finding; then the other sensors by name, by what there is to say of them."""
    known = {s.name: s for s in summary.sensors}
    rows = [(known[f.sensor], f) for f in summary.findings.found]
    others = [s for s in summary.sensors if not summary.findings.of(s.name)]
    groups: dict[str, list[SensorSummary]] = {}
    for s in sorted(others, key=lambda s: -s.suspected):
        groups.setdefault(_kind(s), []).append(s)
    labels = [label for label in KINDS if label in groups]
    return _table(rows, clock) + "".join(_names(label, groups[label], summary) for label in labels)


def _kind(s: SensorSummary) -> str:
    if s.missing == 1.0:
        return "No data"
    if s.first_alarm is not None:
        return "Isolated alarms"
    return "Cannot be checked" if s.uncheckable else "No alarm"


def _sentence(f: Finding, clock: Clock) -> str:
    """A finding, with its time as a link that shows it in the charts."""
    mark = "<b>" if f.lies else '<b class="unblamed">'
    return f"{mark}{escape(f.sensor)}</b> {linked(escape(what(f, clock)), f.since, clock)}"


def _table(found: Sequence[tuple[SensorSummary, Finding]], clock: Clock) -> str:
    """One row per finding, without the columns in which nobody has an entry."""
    rows = [_cells(s, f, clock) for s, f in found]
    used = [k for k in range(len(HEAD)) if any(cells[k] for cells in rows)]
    head = [HEAD[k] for k in used]
    shown = [
        row(head, [cells[k] for k in used], "liar" if f.persistent and not f.faint else "")
        for cells, (_, f) in zip(rows, found, strict=True)
    ]
    return table(head, shown) if shown else ""


def _names(label: str, group: Sequence[SensorSummary], summary: Summary) -> str:
    """Sensors of one kind in a line, each with what there is to say of it besides."""
    if label == "No alarm":
        everyone = len(group) == len(summary.sensors)
        label = f"No alarm from {'any sensor' if everyone else count(len(group), 'other sensor')}"
    ends = [","] * (len(group) - 1) + ["."]
    names = " ".join(
        f"<span>{_tagged(s, summary.samples)}{end}</span>" for s, end in zip(group, ends, strict=True)
    )
    return f'<p class="quiet"><b>{label}:</b> {names}</p>'


def _tagged(s: SensorSummary, samples: int) -> str:
    alarms = count(round(s.suspected * samples), "sample") if s.suspected else ""
    missing = f"{percent(s.missing)} missing" if 0 < s.missing < 1 else ""
    return _name(s) + "".join(f' <span class="tag">{tag}</span>' for tag in (alarms, missing) if tag)


def _name(s: SensorSummary) -> str:
    alone = "cannot be checked" if s.uncheckable and s.first_alarm else ""
    tag = "protected" if s.protected else alone
    return escape(s.name) + (f' <span class="tag">{tag}</span>' if tag else "")


def _cells(s: SensorSummary, f: Finding, clock: Clock) -> tuple[str, ...]:
    chance = "" if f.expected is None or f.faint else f" ({rounded(f.expected)} by chance)"
    return (
        _name(s),
        _verdict(f"{f.verdict} alarms" if f.verdict in ("brief", "faint") else f.verdict),
        moment(f.since, clock),
        "the end" if f.ongoing else moment(f.until, clock),
        "<br>".join(_named(f, c, typical(c).removeprefix("erratic, ")) for c in f.courses if c.known),
        "<br>".join(_named(f, c, _course(c, clock)) for c in f.courses if c.known),
        f"{f.suspected:,} of {f.sent:,}{chance}",
        "" if math.isnan(f.trust) else f"{f.trust:.2f}",
        percent(s.missing) if s.missing else "",
    )


def _verdict(word: str) -> str:
    return f'<span class="verdict-{word.replace(" ", "-")}">{word}</span>'


def _named(f: Finding, c: Course, text: str) -> str:
    """What is added to a channel; the channel is named if there are several."""
    return escape(f"{c.channel}: {text}" if len(f.courses) > 1 else text)


def _course(c: Course, clock: Clock) -> str:
    """How an injection goes on, in a few words."""
    if c.kind is Kind.UNKNOWN:
        return "too short to tell"
    if c.kind not in (Kind.GROWING, Kind.SETTLING):
        return c.kind.value
    how = "growing" if abs(c.last) >= abs(c.first) else "shrinking"
    until = "" if c.settled is None else f" until {clock.text(c.settled)}"
    return f"{how}{until}, {plain(abs(c.slope))} {c.unit}".rstrip() + " per sample"

"""The report: one HTML file that needs nothing else, neither network nor folder."""

from __future__ import annotations

import base64
import hashlib
import json
import os
from collections.abc import Sequence
from functools import lru_cache
from html import escape
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING

from plotly.offline import get_plotlyjs

from securestate._words import enumerate_names
from securestate.reporting import sensor_table, tables
from securestate.reporting.beside import compare_runs, section
from securestate.reporting.blocks import manifest, pack_run
from securestate.reporting.clock import Clock
from securestate.reporting.page import asset, paragraphs, write_page
from securestate.reporting.payload import pack_bytes
from securestate.reporting.summary import Summary, summarise
from securestate.reporting.telling import period

if TYPE_CHECKING:
    from securestate.estimators.run import Run

SCRIPTS = ("data.js", "charts.js", "heatmaps.js", "sections.js", "report.js")


def write_report(
    run: Run,
    path: str | os.PathLike[str],
    *,
    title: str | None = None,
    source: str | os.PathLike[str] | None = None,
    notes: Sequence[str] = (),
    beside: Run | None = None,
) -> Path:
    """Write the report of one run as one HTML file that opens offline. Written whole or not at all.

    Args:
        run: one run, x of shape (T, n); the file holds every sample.
        path: where to write; an existing file is replaced.
        title: default "Sensor report", with the plant's name.
        source: where the measurements came from, shown as given.
        notes: sentences for the reader, shown below the verdict.
        beside: another estimator's run over the same samples, drawn and compared with the states.
    Returns:
        The path written.
    Raises:
        InputError: names `run` if it is a batch of runs or holds no sample, `beside` if it does not fit.
        OSError: the file cannot be written; nothing is left behind.
    """
    return write_page(render(run, title=title, source=source, notes=notes, beside=beside), path)


def render(
    run: Run,
    *,
    title: str | None = None,
    source: str | os.PathLike[str] | None = None,
    notes: Sequence[str] = (),
    beside: Run | None = None,
) -> str:
    """The report as text; arguments as for `write_report`."""
    summary, clock = summarise(run), Clock.of(run)
    both = None if beside is None else compare_runs(run, beside)
    blocks = pack_run(run, clock, beside)
    script = asset(*SCRIPTS)
    data = {f"data-{name}": text for name, (_, text) in blocks.items()} | {"plotly": _plotly()}
    elements = (f'<script type="text/plain" id="{name}">{text}</script>' for name, text in data.items())
    return Template(asset("report.html")).substitute(
        policy=_policy(script),
        style=asset("page.css", "report.css"),
        script=script,
        title=escape(title or f"Sensor report: {summary.plant}".removesuffix(": ")),
        verdict=tables.headline(summary),
        tone="alarm" if summary.liars else "calm",
        findings=sensor_table.sentences(summary, clock),
        remarks=paragraphs([*_remarks(summary, clock), *notes]),
        facts=tables.facts(run, summary, clock, source),
        sensors=sensor_table.sensors(summary, clock),
        unknown=tables.unknown(summary),
        statuses=tables.statuses(summary, clock),
        beside=section(both),
        plant=tables.plant(run),
        manifest=_json(manifest(run, summary, clock, blocks)),
        data="\n".join(elements),
    )


def _remarks(summary: Summary, clock: Clock) -> list[str]:
    silent = tuple(s.name for s in summary.sensors if s.missing == 1.0)
    remarks = [summary.caveat] if summary.caveat else []
    if silent:
        remarks.append(f"Sent nothing during the whole run: {enumerate_names(silent)}.")
    return [*remarks, *(period(p, clock) for p in summary.findings.periods)]


@lru_cache(maxsize=1)
def _plotly() -> str:
    return pack_bytes(get_plotlyjs().encode())


def _json(value: object) -> str:
    """JSON that cannot end the script element it stands in."""
    return json.dumps(value, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def _policy(script: str) -> str:
    """Content security policy: nothing is fetched, and only our script and plotly's run."""
    hashes = " ".join(f"'sha256-{_hash(text)}'" for text in (script, get_plotlyjs()))
    return f"default-src 'none'; script-src {hashes}; style-src 'unsafe-inline'; img-src data: blob:"


def _hash(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")

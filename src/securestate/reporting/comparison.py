"""The report of a comparison: one HTML file without a script, for the screen, the phone and paper."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from html import escape
from importlib.metadata import version
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING

from securestate._words import count, enumerate_names
from securestate.reporting import comparison_figures, comparison_tables
from securestate.reporting.page import asset, compact, definitions, paragraphs, write_page
from securestate.reporting.standing import Standing

if TYPE_CHECKING:
    from securestate.simulation import Comparison


def write_comparison(
    comparison: Comparison,
    path: str | os.PathLike[str],
    *,
    title: str | None = None,
    source: str | os.PathLike[str] | None = None,
    notes: Sequence[str] = (),
) -> Path:
    """Write a comparison as one HTML file that opens offline. Written whole or not at all.

    Args:
        comparison: what `compare` or `campaign` returned.
        path: where to write; an existing file is replaced.
        title: default "Comparison under attack".
        source: what described the comparison, shown as given.
        notes: sentences for the reader, shown below the headline.
    Returns:
        The path written.
    Raises:
        OSError: the file cannot be written; nothing is left behind.
    """
    return write_page(render(comparison, title=title, source=source, notes=notes), path)


def render(
    comparison: Comparison,
    *,
    title: str | None = None,
    source: str | os.PathLike[str] | None = None,
    notes: Sequence[str] = (),
) -> str:
    """The report as text; arguments as for `write_comparison`."""
    standing = Standing.of(comparison)
    return Template(asset("comparison.html")).substitute(
        style=asset("page.css", "comparison.css"),
        title=escape(title or "Comparison under attack"),
        headline=escape(standing.headline),
        remarks=paragraphs([*_remarks(comparison, standing), *notes]),
        facts=_facts(comparison, source),
        ranking=comparison_tables.ranking(comparison, standing),
        matrix=comparison_tables.matrix(comparison, standing),
        refusals=comparison_tables.refusals(comparison),
        nowhere=comparison_tables.nowhere(comparison, standing),
        plants=comparison_figures.plants(comparison),
        meanings=comparison_tables.meanings(),
        version=escape(version("securestate")),
    )


def _remarks(comparison: Comparison, standing: Standing) -> list[str]:
    """What a reader must know before believing the headline."""
    remarks = []
    unmeasured = len(standing.ratio) - len(standing.measured)
    if unmeasured and standing.measured:
        remarks.append(f"In {count(unmeasured, 'scenario')} the oracle cannot run; they are left out here.")
    for name in standing.partial if standing.ranked else ():
        scenarios, own, best = standing.where_it_runs(name)
        if scenarios and own < best:
            remarks.append(
                f"{name} runs in {scenarios} of them. There it has {compact(own)} times the oracle’s squared "
                f"error, {standing.ranked[0]} {compact(best)} times."
            )
    if standing.tied:
        names = enumerate_names(standing.tied)
        remarks.append(f"The runs do not tell {standing.ranked[0]} from {names}: 95 % intervals overlap.")
    if (comparison.table["runs"].max("estimator") == 1).any():
        remarks.append("A scenario with one run has no interval: differences there may be chance.")
    return remarks


def _facts(comparison: Comparison, source: str | os.PathLike[str] | None) -> str:
    """What was run."""
    table = comparison.table
    sizes = table.sizes
    return definitions(
        {
            "Scenarios": f"{sizes['scenario']:,}",
            "Plants": str(len(set(table["plant"].to_numpy()))),
            "Estimators": f"{sizes['estimator'] - 1} and the oracle",
            "Runs per scenario": _values(table["runs"].max("estimator").to_numpy()),
            "Samples per run": _values(table["steps"].to_numpy()),
            "Scored from sample": _values(table["score_from"].to_numpy()),
            "Seed": _values(table["seed"].to_numpy()),
            "Source": "" if source is None else os.fspath(source),
        }
    )


def _values(values: Iterable[float]) -> str:
    """One value, or the range of several; what is missing is left out."""
    known = sorted({int(v) for v in values if v == v})
    if not known:
        return ""
    return f"{known[0]:,}" if len(known) == 1 else f"{known[0]:,} to {known[-1]:,}"

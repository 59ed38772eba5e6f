"""The report of an identification: whether the model is good enough, and the evidence, as one HTML file."""

from __future__ import annotations

import os
from collections.abc import Iterator
from html import escape
from importlib.metadata import version
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING

from securestate._words import count
from securestate.reporting import identification_facts as facts
from securestate.reporting import identification_figures as figures
from securestate.reporting import identification_tables as tables
from securestate.reporting.comparison_tables import scroll
from securestate.reporting.identification_criteria import why
from securestate.reporting.page import asset, compact, paragraphs, table, write_page

if TYPE_CHECKING:
    from securestate.identification import Identified
    from securestate.identification.order import OrderSearch
    from securestate.identification.residuals import Residuals

MARKS = {"good": "✓", "usable": "!", "inadequate": "✕"}
"""The sign of a grade, for those who do not see its colour."""

WARNING = '<span class="warning">– by a model that is inadequate: do not rely on it</span>'
"""Beside what an inadequate model says of sensors."""

HOW = (
    '<p class="hint">How likely models of each size find samples kept back from fitting: higher is better. '
    "The smallest that the data cannot tell from the best is chosen.</p>"
    '<p class="legend"><span><span class="key free"></span>innovations form: one noise for all</span>'
    '<span><span class="key own"></span>independent noises: one per sensor, as a plant needs</span></p>'
)
"""How to read the drawing of orders."""


def write_identification(
    identified: Identified,
    path: str | os.PathLike[str],
    *,
    title: str | None = None,
    source: str | os.PathLike[str] | None = None,
) -> Path:
    """Write what was learned from a history as one HTML file that opens offline. Written whole or not at all.

    Args:
        identified: what `identify` returned.
        path: where to write; an existing file is replaced.
        title: default "Identification report", with the plant's name.
        source: where the history came from, shown as given.
    Returns:
        The path written.
    Raises:
        OSError: the file cannot be written; nothing is left behind.
    """
    return write_page(render(identified, title=title, source=source), path)


def render(
    identified: Identified, *, title: str | None = None, source: str | os.PathLike[str] | None = None
) -> str:
    """The report as text; arguments as for `write_identification`."""
    found, verdict = identified, identified.verdict
    judged = verdict.residuals
    first, *others = verdict.sentences()
    return Template(asset("identification.html")).substitute(
        style=asset("page.css", "comparison.css", "identification.css"),
        title=escape(title or f"Identification report: {found.plant.name}".removesuffix(": ")),
        grade=str(verdict.grade),
        tone="alarm" if verdict.grade == "inadequate" else "calm",
        mark=MARKS[verdict.grade],
        stamp=verdict.grade.capitalize(),
        headline=escape(first),
        reasons=_reasons(found, others),
        learned=escape(found.headline),
        remarks=_remarks(found),
        why=why(verdict.criteria) if judged.samples else "",
        counted=_counted(found),
        others="the other sensors and the inputs" if found.plant.n_inputs else "the other sensors",
        checked=tables.checked(found),
        predicts=_predicts(judged) if judged.samples else "<p>There is no sample to judge the model by.</p>",
        repeated=tables.repeated(judged),
        chance=f"{2 / max(1, int(judged.counted.max(initial=1))) ** 0.5:.2f}",
        orders=_orders(found.search),
        sensors=tables.sensors(found),
        facts=facts.facts(found, source),
        modes=facts.modes(found),
        version=escape(version("securestate")),
    )


def _reasons(found: Identified, sentences: list[str]) -> str:
    """The verdict's other sentences; what is wrong is marked by how bad it is."""
    grades = {str(problem): str(problem.grade) for problem in found.verdict.problems}
    return "".join(f'<li class="{grades.get(one, "note")}">{escape(one)}</li>' for one in sentences)


def _remarks(found: Identified) -> str:
    """What was done to the data and to the model."""
    if not found.remarks:
        return ""
    return f'<ul class="remarks">{"".join(f"<li>{escape(one)}</li>" for one in found.remarks)}</ul>'


def _counted(found: Identified) -> str:
    """How many sensors can be checked; not to be relied on if the model is inadequate."""
    able, total = len(found.verdict.verifiable), found.plant.n_sensors
    counted = f'<b class="many">{able}</b> of {count(total, "sensor")} can be checked'
    if found.verdict.grade == "inadequate":
        return f"{counted} {WARNING}"
    return counted


def _predicts(judged: Residuals) -> str:
    """Errors over the record, and their sizes, with the numbers as a table."""
    above = figures.beyond(judged)
    small, large = figures.dots(judged), figures.stretches(judged)
    each = int((small.last - small.first).max())
    what = "one sample" if each == 1 else f"the mean of about {each} samples"
    hidden = f" {count(above, 'dot')} above the drawing." if above else ""
    caption = f"Each dot is {what}, each dash the mean of a longer stretch.{hidden}"
    rows = (
        f'<tr><th scope="row">{a:,} to {b - 1:,}</th><td>{compact(v)}</td>'
        f"<td>{low:.2f} to {high:.2f}</td></tr>"
        for a, b, v, low, high in zip(
            *(x.tolist() for x in (large.first, large.last, large.value, *large.band)), strict=True
        )
    )
    numbers = scroll(table(("Samples", "Errors", "95 of 100 perfect models"), rows), "Errors by stretch")
    return (
        '<div class="pair"><figure><figcaption>Over the record</figcaption>'
        f'{figures.over_time(judged)}<p class="hint below">{caption}</p></figure>'
        f"<figure><figcaption>How often which size</figcaption>{figures.spread(judged)}"
        '<p class="hint below">Bars: samples. Line: what a perfect model would have.</p></figure></div>'
        f"<details><summary>The stretches as numbers</summary>{numbers}</details>"
    )


def _orders(search: OrderSearch) -> str:
    said = list(_cost(search))
    if len(search.independent) < 2 and len(search.innovations) < 2:
        return paragraphs([f"The number of states was given: {search.order}.", *said])
    every = sorted(set(search.innovations) | set(search.independent))
    rows = (
        f'<tr{" class=leader" if n == search.order else ""}><th scope="row">{n}</th>'
        f"<td>{_nats(search.innovations.get(n))}</td><td>{_nats(search.independent.get(n))}</td></tr>"
        for n in every
    )
    numbers = scroll(table(("States", "Innovations form", "Independent noises"), rows), "Orders as numbers")
    return (
        f"{HOW}<figure>{figures.orders(search)}</figure>{paragraphs(said)}"
        f"<details><summary>The orders as numbers</summary>{numbers}</details>"
    )


def _cost(search: OrderSearch) -> Iterator[str]:
    """What independent noises lose."""
    if search.cost > 0:
        yield (
            f"Independent noises lose {search.cost:.2g} nats per sample against the best innovations form. "
            "They are needed all the same: with a noise that sensors share, the lie of one would look "
            "like the noise of another."
        )
    else:
        yield (
            f"Independent noises lose nothing: they predict by {-search.cost:.2g} nats per sample better "
            "than the best innovations form."
        )


def _nats(value: float | None) -> str:
    return "" if value is None else f"{value:.3f}".replace("-", "−")

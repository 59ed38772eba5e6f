"""Tables of `benches.secure_filter`: a cell, all cells, and what they come to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from benches import table
from benches._secure_methods import TOLD
from benches._secure_score import Results, Summary, against_best, summarise

CELL_COLUMNS = (
    "method", "runs", "MSE/oracle", "± 1 s.e.", "median run", "honest suspected", "liars suspected", "NEES/n",
    "95 %", "over the best", "status", "ms",
)  # fmt: skip
#: An estimator should stay below this many times the oracle's error, wherever the attack is survivable.
TARGET = 1.5
WORST = 12

Rows = list[tuple[str, ...]]


def cell_rows(results: Results) -> Rows:
    """A line per method, those that refuse the plant left out."""
    return [_cell_row(name, one, results) for name, one in summarise(results).items()]


def _cell_row(name: str, one: Summary, results: Results) -> tuple[str, ...]:
    over, _, best = (0.0, 0.0, "") if name in TOLD else against_best(results, name)
    mean, low, high = one.nees
    return (
        name,
        str(one.runs),
        short(one.ratio),
        short(one.error),
        short(one.median),
        _share(one.honest),
        _share(one.attacked),
        short(mean),
        f"{short(low)}–{short(high)}",
        f"{short(over)} ({best})" if best else "",
        ", ".join(f"{status} {n}" for status, n in one.statuses.items() if status != "OK"),
        short(one.milliseconds),
    )


def overview(cells: Mapping[str, Results]) -> tuple[tuple[str, ...], Rows]:
    """Columns and lines: MSE/oracle of every method in every cell."""
    names = _names(cells)
    rows = []
    for line, results in cells.items():
        found = summarise(results)
        ratios = (short(found[name].ratio) if name in found else "—" for name in names)
        rows.append((line, *ratios))
    return ("cell", *names), rows


SUMMARY_COLUMNS = (
    "method", "cells", "geometric mean", f"≤ {TARGET:g}", "honest suspected, no attack", "all cells",
    "NEES/n, median", "worst",
)  # fmt: skip


def summary_rows(cells: Mapping[str, Results]) -> Rows:
    """A line per method over all cells in which it took part."""
    found = {line: summarise(results) for line, results in cells.items()}
    return [_summary_row(name, found) for name in _names(cells)]


def _summary_row(name: str, found: Mapping[str, Mapping[str, Summary]]) -> tuple[str, ...]:
    own = {line: summaries[name] for line, summaries in found.items() if name in summaries}
    ratios = np.array([one.ratio for one in own.values()])
    quiet = [one.honest for line, one in own.items() if " none " in line]
    worst = max(own, key=lambda line: own[line].ratio)
    return (
        name,
        str(len(own)),
        short(float(np.exp(np.mean(np.log(ratios))))),
        f"{np.mean(ratios <= TARGET):.0%}",
        _share(float(np.mean(quiet))) if quiet else "—",
        _share(float(np.mean([one.honest for one in own.values()]))),
        short(float(np.median([one.nees[0] for one in own.values()]))),
        f"{worst}: {short(own[worst].ratio)}",
    )


def worst_rows(cells: Mapping[str, Results], judged: str) -> Rows:
    """The cells in which the judged method is furthest from the oracle."""
    found = {line: summarise(results).get(judged) for line, results in cells.items()}
    own = {line: one for line, one in found.items() if one is not None}
    ranked = sorted(own, key=lambda line: -own[line].ratio)[:WORST]
    return [(line, short(own[line].ratio), short(own[line].error), _best(cells[line])) for line in ranked]


def _best(results: Results) -> str:
    found = {name: one.ratio for name, one in summarise(results).items() if name not in TOLD}
    if not found:
        return "—"
    best = min(found, key=lambda name: (found[name], name))
    return f"{best}: {short(found[best])}"


def beaten_rows(cells: Mapping[str, Results], judged: str) -> Rows:
    """The cells in which another method is better than the judged one, the largest loss first."""
    lost = []
    for line, results in cells.items():
        if judged in results and results[judged].rows:
            over, error, best = against_best(results, judged)
            if over > 1:
                lost.append((over, error, line, best))
    return [
        (line, short(over), short(error), best)
        for over, error, line, best in sorted(lost, key=lambda loss: -loss[0])
    ]


def refusals(cells: Mapping[str, Results]) -> Rows:
    """Which methods take no part, where, and why."""
    found: dict[tuple[str, str], list[str]] = {}
    for line, results in cells.items():
        for name, one in results.items():
            if one.refused:
                found.setdefault((name, one.refused.partition(";")[0]), []).append(line)
    return [
        (name, f"{len(lines)}: {lines[0]}, …" if len(lines) > 1 else lines[0], reason)
        for (name, reason), lines in found.items()
    ]


def _names(cells: Mapping[str, Results]) -> list[str]:
    taken = [name for results in cells.values() for name, one in results.items() if one.rows]
    return list(dict.fromkeys(taken))


def report(cells: Mapping[str, Results], judged: str) -> str:
    """All of it but the single cells, in Markdown."""
    columns, rows = overview(cells)
    parts: list[tuple[str, Sequence[str], Rows]] = [
        ("MSE/oracle", columns, rows),
        ("Over all cells", SUMMARY_COLUMNS, summary_rows(cells)),
        (f"Worst cells of {judged}", ("cell", "MSE/oracle", "±", "the best"), worst_rows(cells, judged)),
        (
            f"Where {judged} is not the best",
            ("cell", "times the best", "±", "which is"),
            beaten_rows(cells, judged),
        ),
        ("Who takes no part", ("method", "cells", "why"), refusals(cells)),
    ]
    lines = [[f"## {title}", *table.markdown(head, body), ""] for title, head, body in parts]
    return "\n".join(line for part in lines for line in part)


def short(value: float) -> str:
    """Three digits."""
    if not np.isfinite(value):
        return "—" if np.isnan(value) else "∞"
    return f"{value:.3g}"


def _share(value: float) -> str:
    return "—" if np.isnan(value) else f"{100 * value:.3g} %"

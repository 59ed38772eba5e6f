"""The tables of a comparison that everybody reads: the ranking, the scenarios, where nothing works."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from html import escape
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from securestate._words import count
from securestate.reporting.page import compact, percent, table
from securestate.reporting.standing import FAR, NEAR, Standing, frame_of
from securestate.simulation.comparison import MEANING

if TYPE_CHECKING:
    from securestate.simulation import Comparison

SHADES = (1.1, NEAR, FAR, 10.0, 100.0)
"""Upper ends of the colours of the matrix; about equally far apart on a logarithmic scale."""

LABELS: Mapping[str, str] = {
    "mse": "Squared error",
    "ratio": "Times the oracle’s",
    "nees": "NEES",
    "nis": "NIS",
    "false_alarm_rate": "False alarms",
    "detection_rate": "Detection",
    "delay": "Delay, samples",
    "found": "Ever found",
    "exact_sets": "Exact sets",
    "injection_rms": "Injection error, σ",
    "not_ok": "Status not OK",
}
"""What figures are called on the page."""

RANKED = (
    "Rank",
    "Estimator",
    "Mean ratio",
    "Worst ratio",
    "Worst in",
    f"Within {NEAR:g}",
    "False alarms, no attack",
    "False alarms, under attack",
    "Detection",
    "µs per step",
    "Runs in",
)


def scroll(inside: str, label: str) -> str:
    """A box of its own for what may be wider than the page."""
    return f'<div class="scroll" role="region" tabindex="0" aria-label="{escape(label)}">{inside}</div>'


def rate(share: float) -> str:
    """A share in per cent, or a dash."""
    return "–" if np.isnan(share) else percent(share)


def scenario_labels(comparison: Comparison) -> Mapping[str, str]:
    """What a scenario is called below the name of its plant: its adversary, if that tells it from others."""
    frame = comparison.table[["plant", "attack"]].to_dataframe().reset_index()
    unclear = frame.duplicated(["plant", "attack"], keep=False) | (frame["attack"] == "")
    return dict(zip(frame["scenario"], frame["attack"].where(~unclear, frame["scenario"]), strict=True))


def by_plant(comparison: Comparison) -> Iterator[tuple[str, list[str]]]:
    """Plants in the order in which they come, each with its scenarios."""
    plants = dict(zip(comparison.table["scenario"].values, comparison.table["plant"].values, strict=True))
    order = list(dict.fromkeys(plants.values()))
    for plant, names in groupby(sorted(plants, key=lambda s: order.index(plants[s])), key=plants.__getitem__):
        yield plant or "plant without a name", list(names)


def ranking(comparison: Comparison, standing: Standing) -> str:
    """Who runs everywhere, best first; then who does not, without a rank; then the oracle."""
    rows = [_ranked(comparison, standing, name, str(i)) for i, name in enumerate(standing.ranked, 1)]
    rows += [_ranked(comparison, standing, name, "–") for name in standing.partial]
    return scroll(table(RANKED, [*rows, _yardstick(comparison, standing)]), "Ranking")


def _ranked(comparison: Comparison, s: Standing, name: str, rank: str) -> str:
    ratio, speed = s.ratio[name], comparison.timing[name].median()
    found = comparison.table["detection_rate"].sel(estimator=name)
    alarms = comparison.table["false_alarm_rate"].sel(estimator=name)
    attacked = comparison.table["attacked"]
    cells = (
        compact(s.mean[name]),
        compact(float(ratio.max())),
        escape(str(ratio.idxmax())) if ratio.notna().any() else "–",
        f"{int((ratio <= NEAR).sum())} of {len(ratio)}",
        rate(float(alarms.where(~attacked).mean())),
        rate(float(alarms.where(attacked).mean())),
        rate(float(found.mean())),
        compact(float(speed)),
        f"{int(ratio.notna().sum())} of {len(ratio)}",
    )
    kind = "leader" if name in s.best else "unranked" if rank == "–" else ""
    return _ranking_row(kind, rank, escape(name), cells)


def _yardstick(comparison: Comparison, s: Standing) -> str:
    cells = ("1", "–", "–", "–", "told", "told", "told")
    speed = compact(float(comparison.timing[s.oracle].median()))
    runs = f"{len(s.measured)} of {len(s.ratio)}"
    name = f'{escape(s.oracle)} <span class="tag">yardstick</span>'
    return _ranking_row("yardstick", "", name, (*cells, speed, runs))


def _ranking_row(kind: str, rank: str, name: str, cells: tuple[str, ...]) -> str:
    columns = "".join(
        f'<td class="where">{c}</td>' if i == 2 else f"<td>{c}</td>" for i, c in enumerate(cells)
    )
    return f'<tr class="{kind}"><td>{rank}</td><th scope="row">{name}</th>{columns}</tr>'


def matrix(comparison: Comparison, standing: Standing) -> str:
    """Every scenario by every estimator; the colour and the number tell the ratio to the oracle."""
    labels, far = scenario_labels(comparison), standing.beyond(FAR)
    order = [*standing.ranked, *standing.partial]
    numbers = {key: i for i, (key, _) in enumerate(_refused(comparison), 1)}
    rows = []
    for plant, scenarios in by_plant(comparison):
        rows.append(
            f'<tr class="plant"><th scope="rowgroup" colspan="{2 + len(order)}">{escape(plant)}</th></tr>'
        )
        for scenario in scenarios:
            mark = ' <span class="tag far">✕ nothing works</span>' if scenario in far else ""
            yardstick = compact(
                float(comparison.table["mse"].sel(scenario=scenario, estimator=standing.oracle))
            )
            cells = "".join(_cell(comparison, standing, scenario, name, numbers) for name in order)
            label = f'<th scope="row">{escape(labels[scenario])}{mark}</th>'
            rows.append(f'<tr>{label}{cells}<td class="soft">{yardstick}</td></tr>')
    head = ("Adversary", *(escape(name) for name in order), "Oracle’s squared error")
    return scroll(table(head, rows), "Every scenario")


def _cell(
    comparison: Comparison, s: Standing, scenario: str, name: str, numbers: Mapping[tuple[str, str], int]
) -> str:
    one = comparison.table.sel(scenario=scenario, estimator=name)
    if reason := str(one["refusal"].item()):
        return f'<td class="refused">cannot run<sup>{numbers[name, reason]}</sup></td>'
    ratio = float(one["ratio"])
    best = " best" if compact(ratio) == compact(float(s.ratio.T[scenario].min())) != "–" else ""
    title = f"{name}: {interval(one, 'ratio')} times the oracle’s; squared error {interval(one, 'mse')}"
    star = '<span class="star" aria-label="best"> ★</span>' if best else ""
    return f'<td class="{shade(ratio)}{best}" title="{escape(title)}">{compact(ratio)}{star}</td>'


def shade(ratio: float) -> str:
    """The class of a cell's colour.

    Examples:
        >>> [shade(r) for r in (0.98, 1.5, 1.6, 1e50, float("nan"))]
        ['shade0', 'shade1', 'shade2', 'shade5', '']
    """
    return "" if np.isnan(ratio) else f"shade{int(np.searchsorted(SHADES, ratio))}"


def interval(cell: object, figure: str) -> str:
    """A figure with its 95 % interval."""
    value, low, high = (compact(float(cell[figure + end])) for end in ("", "_low", "_high"))  # type: ignore[index]
    return value if "–" in (low, high) else f"{value} ({low} to {high})"


def _refused(comparison: Comparison) -> list[tuple[tuple[str, str], list[str]]]:
    """Estimators and the reasons why they cannot run, each with the scenarios."""
    found: dict[tuple[str, str], list[str]] = {}
    for name, reasons in frame_of(comparison, "refusal").items():
        for scenario, reason in reasons.items():
            if reason:
                found.setdefault((str(name), reason), []).append(str(scenario))
    return list(found.items())


def refusals(comparison: Comparison) -> str:
    """Why estimators cannot run, numbered as in the matrix."""
    items = "".join(
        f"<li><b>{escape(name)}</b> cannot run in {_scenarios(scenarios)}: {escape(reason)}</li>"
        for (name, reason), scenarios in _refused(comparison)
    )
    return f"<h3>What cannot run, and why</h3><ol>{items}</ol>" if items else ""


def _scenarios(names: list[str]) -> str:
    return (
        escape(names[0])
        if len(names) == 1
        else f"{count(len(names), 'scenario')} ({escape('; '.join(names))})"
    )


def nowhere(comparison: Comparison, standing: Standing) -> str:
    """The scenarios in which no estimator comes within `FAR` times the oracle's squared error."""
    far = standing.beyond(FAR)
    if not standing.ratio.columns.size or not standing.measured:
        return "<p>Nothing was compared.</p>"
    if not far:
        return f"<p>Nowhere: in every scenario some estimator comes within {FAR:g} times.</p>"
    return f"<ul>{''.join(_far(comparison, standing, scenario) for scenario in far)}</ul>"


def _far(comparison: Comparison, s: Standing, scenario: str) -> str:
    ratio = s.ratio.loc[scenario]
    if ratio.isna().all():
        return f"<li><b>{escape(scenario)}</b>: no estimator can run.</li>"
    best = ratio.idxmin()
    cell = comparison.table.sel(scenario=scenario, estimator=best)
    return (
        f"<li><b>{escape(scenario)}</b>: the closest is {escape(str(best))} with"
        f" {interval(cell, 'ratio')} times the oracle’s squared error.</li>"
    )


def meanings() -> str:
    """Every figure in one line."""
    own = {
        "Mean ratio": "geometric mean over scenarios of mse over the oracle’s, where the estimator runs",
        f"Within {NEAR:g}": f"scenarios in which the ratio is at most {NEAR:g}, of all",
        "False alarms and detection in the ranking": "means of the scenarios’ rates",
        "µs per step": "median over scenarios of the time one step of one filter takes on one thread;"
        " it depends on the machine and its load",
    }
    texts = own | {LABELS[name]: text for name, text in MEANING.items() if name in LABELS}
    rows = (
        f'<tr><th scope="row">{escape(k)}</th><td class="where">{escape(v)}</td></tr>'
        for k, v in texts.items()
    )
    return scroll(table(("Figure", "Meaning"), rows), "Meaning of every figure")

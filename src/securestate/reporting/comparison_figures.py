"""All figures of a comparison, plant by plant, folded away until somebody looks."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

from securestate.reporting.comparison_tables import (
    LABELS,
    by_plant,
    interval,
    rate,
    scenario_labels,
    scroll,
)
from securestate.reporting.curves import chart
from securestate.reporting.page import compact, table
from securestate.simulation.metrics import PER_SENSOR

if TYPE_CHECKING:
    from securestate.simulation import Comparison

Format = Callable[[Any, str], str]


def _number(cell: Any, figure: str) -> str:
    return compact(float(cell[figure]))


def _rate(cell: Any, figure: str) -> str:
    return rate(float(cell[figure]))


def _delay(cell: Any, figure: str) -> str:
    value = float(cell[figure])
    return "most never" if value == float("inf") else "–" if value != value else f"{value:g}"


ERRORS: Mapping[str, Format] = {
    "mse": interval,
    "ratio": interval,
    "nees": _number,
    "nis": _number,
    "not_ok": _rate,
}
DETECTION: Mapping[str, Format] = {
    "false_alarm_rate": _rate,
    "detection_rate": _rate,
    "delay": _delay,
    "found": _rate,
    "exact_sets": _rate,
    "injection_rms": _number,
}


def plants(comparison: Comparison) -> str:
    """One folded part per plant: errors over time, errors, detection, sensors."""
    labels = scenario_labels(comparison)
    return "".join(
        f"<details><summary>{escape(plant)}</summary>"
        f"<h3>Squared error over time</h3>{_charts(comparison, names, labels)}"
        f"<h3>Errors, with 95 % intervals</h3>{_figures(comparison, names, labels, ERRORS)}"
        f"<h3>Detection</h3>{_figures(comparison, names, labels, DETECTION)}"
        f"{_sensors(comparison, names)}</details>"
        for plant, names in by_plant(comparison)
    )


def _charts(comparison: Comparison, scenarios: Sequence[str], labels: Mapping[str, str]) -> str:
    figures = []
    for name in scenarios:
        one = comparison.table.sel(scenario=name)
        curves = {
            str(e): one["squared_error"]
            .sel(estimator=e)
            .to_numpy()[: 0 if one["refusal"].sel(estimator=e).item() else int(one["steps"])]
            for e in one["estimator"].to_numpy()
        }
        if any(curve.size for curve in curves.values()):
            start = int(one["attack_from"])
            attack_from = None if start < 0 else start
            title = f"Squared error over time: {name}"
            drawing = chart(curves, int(one["score_from"]), title, attack_from)
            figures.append(f"<figure><figcaption>{escape(labels[name])}</figcaption>{drawing}</figure>")
    return f'<div class="charts">{"".join(figures)}</div>'


def _figures(
    comparison: Comparison, scenarios: Sequence[str], labels: Mapping[str, str], formats: Mapping[str, Format]
) -> str:
    """One row per scenario and estimator that runs."""
    rows = []
    for name in scenarios:
        ran = comparison.table.sel(scenario=name)
        ran = ran.isel(estimator=(ran["refusal"] == "").to_numpy())
        for i, estimator in enumerate(ran["estimator"].to_numpy()):
            span = f'<th scope="rowgroup" rowspan="{ran.sizes["estimator"]}">{escape(labels[name])}</th>'
            cell = ran.isel(estimator=i)
            figures = "".join(f"<td>{write(cell, figure)}</td>" for figure, write in formats.items())
            rows.append(f'<tr>{"" if i else span}<th scope="row">{escape(str(estimator))}</th>{figures}</tr>')
    return scroll(table(("Adversary", "Estimator", *(LABELS[f] for f in formats)), rows), "Figures")


def _sensors(comparison: Comparison, scenarios: Sequence[str]) -> str:
    """Rates of every sensor over all scenarios of a plant; not where sensors only have numbers."""
    _, *others = comparison.table["estimator"].to_numpy().tolist()
    frame = comparison.sensors
    frame = frame[frame["scenario"].isin(scenarios) & frame["estimator"].isin(others)]
    if frame.empty or all(re.fullmatch(r"[A-Za-z]?\d+", name) for name in frame["sensor"]):
        return ""
    sums = frame.groupby(["sensor", "estimator"], sort=False)[list(PER_SENSOR)].sum()
    ran = [name for name in others if name in set(frame["estimator"])]
    rows = []
    for sensor in dict.fromkeys(frame["sensor"]):
        ones = [sums.loc[(sensor, name)] for name in ran]
        cells = "".join(
            f"<td>{_share(one, 'detections', 'lies')}</td><td>{_share(one, 'false_alarms', 'honest')}</td>"
            for one in ones
        )
        rows.append(f'<tr><th scope="row">{escape(str(sensor))}</th>{cells}</tr>')
    head = ("Sensor", *(f"{escape(n)}: {what}" for n in ran for what in ("detection", "false alarms")))
    inside = scroll(table(head, rows), "Sensors")
    return f"<details><summary>By sensor, over all its scenarios</summary>{inside}</details>"


def _share(counts: Any, part: str, whole: str) -> str:
    return rate(counts[part] / counts[whole] if counts[whole] else float("nan"))

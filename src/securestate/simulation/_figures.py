"""The pictures of a comparison."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from securestate.errors import InputError

if TYPE_CHECKING:
    import plotly.graph_objects as go

    from securestate.simulation.comparison import Comparison

#: Ratio to the oracle at which the colour scale ends.
WORST = 100.0


def heat_map(comparison: Comparison) -> go.Figure:
    """The ratio to the oracle, scenarios by estimators, on a logarithmic colour scale."""
    import plotly.graph_objects as go

    ratio = comparison.table["ratio"]
    values = ratio.to_numpy()
    with np.errstate(all="ignore"):
        shade = np.log10(np.clip(values, 1.0, WORST))
    figure = go.Heatmap(
        x=ratio["estimator"].to_numpy(),
        y=ratio["scenario"].to_numpy(),
        z=shade,
        text=[["" if np.isnan(value) else f"{value:.3g}" for value in row] for row in values],
        texttemplate="%{text}",
        zmin=0,
        zmax=float(np.log10(WORST)),
        colorscale="YlOrRd",
        colorbar={"title": "MSE / oracle", "tickvals": [0, 1, 2], "ticktext": ["1", "10", "≥ 100"]},
    )
    height = 160 + 24 * len(values)
    return go.Figure(figure).update_layout(
        height=height, title="Mean squared error over the oracle's", yaxis={"autorange": "reversed"}
    )


def errors(comparison: Comparison, scenario: str) -> go.Figure:
    """The squared error over time, averaged over runs, one line per estimator, on a logarithmic axis."""
    import plotly.graph_objects as go

    names = comparison.table["scenario"].to_numpy().tolist()
    if scenario not in names:
        raise InputError("scenario", f"one of {', '.join(names)}", repr(scenario))
    one = comparison.table.sel(scenario=scenario)
    steps = int(one["steps"])
    lines = [
        go.Scatter(
            x=np.arange(steps),
            y=one["squared_error"].sel(estimator=name).to_numpy()[:steps],
            name=name,
            mode="lines",
        )
        for name in one["estimator"].to_numpy().tolist()
        if not str(one["refusal"].sel(estimator=name).item())
    ]
    return go.Figure(lines).update_layout(
        title=scenario, xaxis_title="sample", yaxis={"type": "log", "title": "mean squared error"}
    )

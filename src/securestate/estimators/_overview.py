"""The picture of `Run.plot`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from securestate.errors import InputError

if TYPE_CHECKING:
    import plotly.graph_objects as go

    from securestate.estimators.run import Run


def overview(run: Run, time: NDArray[Any]) -> go.Figure:
    """Trust of every sensor as a heat map above the innovations in standard deviations."""
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    if run.runs is not None:
        raise InputError("run", "a single run", f"a batch of {run.runs} runs; select one first")
    figure = make_subplots(
        rows=2,
        shared_xaxes=True,
        vertical_spacing=0.08,
        subplot_titles=("Trust", "Innovation / standard deviation"),
    )
    rows = [
        f"{name} (cannot be checked)" if alone else name
        for name, alone in zip(run.plant.sensor_names, run.plant.uncheckable, strict=True)
    ]
    trust = go.Heatmap(
        x=time,
        y=rows,
        z=run.trust.T,
        zmin=0,
        zmax=1,
        colorscale="RdBu",
        colorbar={"len": 0.45, "y": 0.78},
    )
    figure.add_trace(trust, row=1, col=1)
    for name, values in zip(run.plant.channel_names, (run.innovation / run.innovation_std).T, strict=True):
        line = go.Scattergl(x=time, y=np.asarray(values), mode="lines", name=name, showlegend=False)
        figure.add_trace(line, row=2, col=1)
    return figure.update_layout(height=700, title=f"{run.estimator} on {run.plant.name or 'plant'}")

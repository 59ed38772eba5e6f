"""Figures as SVG text that depends on the numbers only."""

from __future__ import annotations

import io
from collections.abc import Callable

import matplotlib as mpl
from matplotlib.figure import Figure

STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
}
BLUE, RED, GREY = "#1f6f8b", "#b8442c", "#6b6b6b"


def svg(salt: str, draw: Callable[[Figure], None], size: tuple[float, float] = (7.2, 4.4)) -> str:
    """Return what `draw` puts on an empty figure as SVG; `salt` is the paper's key and makes the ids."""
    with mpl.rc_context({**STYLE, "svg.hashsalt": salt}):
        figure = Figure(figsize=size, layout="constrained")
        draw(figure)
        text = io.StringIO()
        figure.savefig(text, format="svg", facecolor="white", metadata={"Date": None})
    return text.getvalue()

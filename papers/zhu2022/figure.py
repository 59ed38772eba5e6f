"""Figs. 2 to 8, drawn again."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from matplotlib.axes import Axes

from papers import _figure
from papers._figure import BLUE, GREY, RED
from papers._statistics import Float
from papers.zhu2022.monte_carlo import Curves

BLACK, GREEN, OCHRE, VIOLET = "#222222", "#4f8a3c", "#c58a1b", "#7a5195"
#: Label, name of the estimator, colour, dashes.
Line = tuple[str, str, str, str]

ORACLE: Line = ("oracle", "oracle", GREY, ":")
COMPENSATED: Line = ("compensator, ε = 0.45", "mixture 0.45", BLACK, "-")
PAIR: list[Line] = [("no compensator", "mixture none", RED, "-"), COMPENSATED]
THRESHOLDS: list[Line] = [
    ("ε = 0.15", "mixture 0.15", OCHRE, "-"),
    ("ε = 0.45", "mixture 0.45", BLACK, "-"),
    ("ε = 0.65", "mixture 0.65", BLUE, "-"),
    ("ε = 0.95", "mixture 0.95", RED, "-"),
]
DETECTORS: list[Line] = [
    ("χ² per sensor", "chi2 sensor", RED, "-"),
    ("χ² central", "chi2 central", GREEN, "-"),
    ("mixture, ε = 0.45", "mixture 0.45", BLACK, "-"),
]
OURS: list[Line] = [("InnovationMixture", "innovation", VIOLET, "-"), ORACLE]


def draw(curves: Curves) -> dict[str, str]:
    """Return all figures as SVG, by file name."""
    drawings: dict[str, Callable[[Axes, Curves], None]] = {
        "fig2.svg": lambda axes, all_: _states(axes, all_, "25", PAIR, "Fig. 2; one run under (25)"),
        "fig3.svg": lambda axes, all_: _errors(axes, all_, "25", PAIR, "Fig. 3; mean over all systems, (25)"),
        "fig4.svg": _fig4,
        "fig5.svg": lambda axes, all_: _states(axes, all_, "25", THRESHOLDS, "Fig. 5; one run under (25)"),
        "fig6.svg": lambda axes, all_: _errors(
            axes, all_, "25", THRESHOLDS, "Fig. 6; mean over all systems, (25)"
        ),
        "fig7.svg": lambda axes, all_: _states(axes, all_, "26", DETECTORS, "Fig. 7; one run under (26)"),
        "fig8.svg": lambda axes, all_: _errors(
            axes, all_, "26", DETECTORS, "Fig. 8; mean over all systems, (26)"
        ),
    }
    return {
        name: _figure.svg("zhu2022", lambda figure, one=one: one(figure.add_subplot(), curves), (8.0, 4.0))
        for name, one in drawings.items()
    }


def _states(axes: Axes, curves: Curves, attack: str, lines: Iterable[Line], title: str) -> None:
    path = curves.paths[attack]
    _line(axes, curves, path.x, GREY, "-", "state", width=3)
    for label, name, colour, dashes in lines:
        _line(axes, curves, path.estimates[name], colour, dashes, label)
    low, high = path.x.min(), path.x.max()
    axes.set(ylabel="x", ylim=(low - 3, high + 5))
    _finish(axes, title)


def _errors(axes: Axes, curves: Curves, attack: str, lines: Iterable[Line], title: str) -> None:
    for label, name, colour, dashes in [*lines, *OURS]:
        _line(axes, curves, curves.squares[attack, name], colour, dashes, label)
    axes.set(yscale="log", ylabel="mean squared error", ylim=(0.03, 60))
    axes.set_yticks([0.03, 0.1, 0.3, 1, 3, 10, 30], ["0.03", "0.1", "0.3", "1", "3", "10", "30"])
    axes.minorticks_off()
    _finish(axes, f"{title}; the last two lines are ours")


def _fig4(axes: Axes, curves: Curves) -> None:
    attacked = curves.paths["25"].attacked
    axes.bar(_time(curves, attacked), attacked, width=0.7, color=BLUE)
    axes.set(xlabel="t", ylabel="attacked sensors of 15", ylim=(0, 6.5), xlim=(30, 131))
    axes.set_title("Fig. 4; one run", loc="left", fontsize=10)


def _time(curves: Curves, values: Float) -> np.ndarray:
    """The paper counts from t = 1."""
    return curves.start + 1 + np.arange(len(values))


def _line(
    axes: Axes, curves: Curves, values: Float, colour: str, dashes: str, label: str, width: float = 1.2
) -> None:
    axes.plot(_time(curves, values), values, dashes, color=colour, label=label, linewidth=width)


def _finish(axes: Axes, title: str) -> None:
    axes.set(xlabel="t", xlim=(30, 131))
    axes.legend(frameon=False, ncols=3, loc="upper right", fontsize=8.5)
    axes.set_title(title, loc="left", fontsize=10)

"""Fig. 2: normalised mean squared error over γ."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from papers import _figure
from papers._figure import BLUE as BENIGN
from papers._figure import GREY
from papers._figure import RED as ATTACKED
from papers._report import Value
from papers.liu2020.monte_carlo import Curve

PAPER = 0.75  # the γ at which the paper sees the minimum


def draw(curve: Curve, attack: float) -> str:
    """Return the figure as SVG."""
    return _figure.svg("liu2020", lambda figure: _draw(figure.add_subplot(), curve, attack))


def _draw(axes: Axes, curve: Curve, attack: float) -> None:
    gamma = np.array(curve.gamma)
    _line(axes, gamma, curve.benign, BENIGN, "o")
    lies = _line(axes, gamma, curve.attacked, ATTACKED, "s")
    _label(axes, curve, lies, attack)
    axes.set(xscale="log", yscale="log", xlabel="γ", ylabel="mean squared error / tr P")
    axes.set_ylim(0.85, 60)
    axes.set_xlim(gamma[0] * 0.9, 8)
    ticks = [0.05, 0.1, 0.2, 0.3, 0.5, 0.75, 1, 2, 3, 5]
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set_yticks([1, 2, 3, 5, 10, 20, 50], ["1", "2", "3", "5", "10", "20", "50"])
    axes.minorticks_off()
    axes.set_title(
        "Fig. 2 of liu2020, simulated again; bars are ± 2 standard errors", loc="left", fontsize=10
    )


def _line(axes: Axes, gamma: np.ndarray, values: list[Value], colour: str, marker: str) -> np.ndarray:
    mean, error = np.array([(value.number, value.error) for value in values]).T
    axes.errorbar(gamma, mean, 2 * error, color=colour, marker=marker, markersize=4, linewidth=1.4)
    return mean


def _label(axes: Axes, curve: Curve, lies: np.ndarray, attack: float) -> None:
    best = int(lies.argmin())
    axes.axhline(1, color=GREY, linewidth=0.8, zorder=0)
    axes.axhline(curve.oracle, color=GREY, linewidth=0.8, linestyle="--", zorder=0)
    axes.axvline(PAPER, color=GREY, linewidth=0.8, linestyle=":", zorder=0)
    axes.text(0.047, 0.985, "Kalman filter, nobody lies", color=GREY, fontsize=8, va="top")
    axes.text(
        7.9,
        curve.oracle * 1.02,
        f"Kalman filter without sensor 1: {curve.oracle:.2f}",
        color=GREY,
        fontsize=8,
        ha="right",
    )
    axes.text(PAPER * 1.04, 24, "minimum\naccording to\nthe paper", color=GREY, fontsize=8, va="center")
    axes.text(0.055, 1.52, "nobody lies", color=BENIGN)
    axes.text(0.055, 2.65, f"sensor 1 adds {attack:g}", color=ATTACKED)
    axes.annotate(
        f"our minimum: {lies[best]:.2f} at γ = {curve.gamma[best]:g}",
        (curve.gamma[best], lies[best]),
        (0.11, 5),
        color=ATTACKED,
        arrowprops={"arrowstyle": "-", "color": ATTACKED, "shrinkB": 4},
    )

"""Figs. 2 to 5, drawn again, with the lines that the paper leaves out."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from papers import _figure
from papers._figure import BLUE, GREY, RED
from papers.chen2022.monte_carlo import Curves

BLACK, GREEN, OCHRE, VIOLET = "#222222", "#4f8a3c", "#c58a1b", "#7a5195"
#: Label, key of `Curves.state`, colour, dashes.
Line = tuple[str, str, str, str]
PROTECTED = "protected sensors only"


def draw(curves: Curves) -> dict[str, str]:
    """Return all figures as SVG, by file name."""
    drawings: dict[str, tuple[Callable[[Figure, Curves], None], tuple[float, float]]] = {
        "fig2.svg": (_fig2, (7.2, 4.0)),
        "fig3.svg": (_fig3, (7.2, 6.4)),
        "fig4.svg": (_fig4, (7.2, 4.2)),
        "fig5.svg": (_fig5, (9.6, 4.2)),
    }
    return {
        name: _figure.svg("chen2022", lambda figure, one=one: one(figure, curves), size)
        for name, (one, size) in drawings.items()
    }


def _fig2(figure: Figure, curves: Curves) -> None:
    axes = figure.add_subplot()
    colours = dict(zip(sorted({eta for _, eta in curves.attack}), (RED, OCHRE, BLUE, GREEN), strict=True))
    for (form, eta), error in curves.attack.items():
        exact = form == "exact"
        _line(axes, error, colours[eta], "--" if exact else "-", "" if exact else f"η₂ = {eta:g}")
    axes.set(yscale="log", xlabel="k", ylabel="mean squared error of the injection on sensor 2")
    axes.legend(frameon=False, ncols=4, loc="upper left", fontsize=9)
    axes.set_ylim(0.03, 14)
    _title(axes, "Fig. 2; solid as printed, dashed exact")


def _fig3(figure: Figure, curves: Curves) -> None:
    panels = figure.subplots(curves.x.shape[1], 1, sharex=True)
    for i, axes in enumerate(panels):
        _line(axes, curves.x[:, i], GREY, "-", "state")
        _line(axes, curves.fused[:, i], RED, "--", "fusion, η₁ = η₂ = 1")
        axes.set_ylabel(f"x{'₁₂₃₄'[i]}")
    panels[0].legend(frameon=False, ncols=2, loc="upper right", fontsize=9)
    panels[-1].set_xlabel("k")
    _title(panels[0], "Fig. 3; one run")


def _fig4(figure: Figure, curves: Curves) -> None:
    axes = figure.add_subplot()
    lines: list[Line] = [
        ("local 1", "printed.local 1", OCHRE, "-"),
        ("local 2", "printed.local 2", BLUE, "-"),
        ("fusion", "printed.fusion", RED, "-"),
        (PROTECTED, "protected only", BLACK, ":"),
        ("AdaptiveJointFilter", "adaptive joint", GREEN, "-"),
    ]
    _errors(axes, curves, lines)
    axes.set_ylim(0, 1.6)
    _title(axes, "Fig. 4; the dotted line and the green one are ours")


def _fig5(figure: Figure, curves: Curves) -> None:
    left, right = figure.subplots(1, 2)
    local: Line = ("local 1", "printed.local 1", RED, "-")
    protected: Line = (PROTECTED, "protected only.local 1", BLACK, ":")
    colours = (OCHRE, BLUE, GREEN, VIOLET)
    augmented = _family(curves, "augmented ", "augmented, q =", colours)
    zhang = _family(curves, "zhang ", "Zhang, forgetting", colours)
    for axes, rivals in ((left, augmented), (right, zhang)):
        _errors(axes, curves, [local, *rivals, protected])
        axes.set(yscale="log", ylim=(0.6, 12))
        axes.set_yticks([0.6, 1, 2, 3, 5, 10], ["0.6", "1", "2", "3", "5", "10"])
        axes.minorticks_off()
    _title(left, "Fig. 5(a); the dotted line is ours")
    _title(right, "Fig. 5(b); the dotted line is ours")


def _family(curves: Curves, start: str, label: str, colours: Iterable[str]) -> list[Line]:
    """One line per setting of a competitor of local 1."""
    keys = [key for key in curves.state if key.startswith(start) and key.endswith(".local 1")]
    settings = [key.removeprefix(start).removesuffix(".local 1") for key in keys]
    return [
        (f"{label} {setting}", key, colour, "-")
        for setting, key, colour in zip(settings, keys, colours, strict=False)
    ]


def _errors(axes: Axes, curves: Curves, lines: Iterable[Line]) -> None:
    for label, key, colour, dashes in lines:
        _line(axes, curves.state[key], colour, dashes, label)
    axes.set(xlabel="k", ylabel="mean squared error of the state")
    axes.legend(frameon=False, ncols=2, loc="upper right", fontsize=9)


def _line(axes: Axes, values: np.ndarray, colour: str, dashes: str, label: str) -> None:
    k = np.arange(1, len(values) + 1)
    axes.plot(k, values, dashes, color=colour, label=label or None, linewidth=1 if dashes == "--" else 1.4)
    axes.set_xlim(0, len(values))


def _title(axes: Axes, text: str) -> None:
    axes.set_title(text, loc="left", fontsize=10)

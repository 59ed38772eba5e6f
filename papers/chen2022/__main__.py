"""Reproduce chen2022, Section IV; exit code 1 if a number of expected.json does not come out."""

from __future__ import annotations

import sys
from collections.abc import Callable

from rich.console import Console

from papers import _program
from papers._report import Value
from papers.chen2022 import controller, failures, figure, moments, monte_carlo, recursion
from papers.chen2022.setting import FOLDER, Setting


def compute(setting: Setting, console: Console) -> tuple[dict[str, Value], monte_carlo.Curves]:
    """All numbers by the keys of expected.json, and the curves of the figures."""
    parts: dict[str, Callable[[Setting], dict[str, Value]]] = {
        "gains and traces": recursion.traces,
        "convergence": recursion.settled,
        "one run": recursion.one_run,
        "second moments": moments.judged,
        "missing readings": failures.dropouts,
        "falling factor": failures.step,
        "controller": controller.controller,
        "theory": monte_carlo.theory,
    }
    found: dict[str, Value] = {}
    with console.status("simulating") as status:
        for name, part in parts.items():
            status.update(name)
            found |= part(setting)
        status.update("Fig. 2")
        attack, values = monte_carlo.fig2(setting)
        status.update("all estimators")
        squares = monte_carlo.errors(setting)
    found |= values | monte_carlo.table(squares) | monte_carlo.claims(setting, squares)
    return found, monte_carlo.curves(setting, squares, attack)


def reproduce(size: str, console: Console) -> _program.Result:
    """All numbers and the figures."""
    setting = Setting(size)
    found, curves = compute(setting, console)
    scale, seeds = setting.scale, setting.config["simulation"]["seeds"]
    setup = (
        f"Mean squared errors come from {len(seeds)} seeds with {scale['runs']} runs of "
        f"{setting.config['simulation']['steps']} samples each, second moments from {scale['moments']} runs, "
        f"breakdowns from {scale['dropouts']}. Every simulated number has its standard error after ±."
    )
    return _program.Result(found, setup, lambda: figure.draw(curves))


def main(arguments: list[str] | None = None) -> int:
    """Run the program; returns its exit code."""
    return _program.run(FOLDER, __doc__, reproduce, arguments)


if __name__ == "__main__":
    sys.exit(main())

"""Reproduce liu2020, Section VI; exit code 1 if a number of expected.json does not come out."""

from __future__ import annotations

import sys
from collections.abc import Callable

from rich.console import Console

from papers import _program, _report
from papers._report import Value
from papers.liu2020 import design, figure, monte_carlo, theorem4
from papers.liu2020.setting import FOLDER, Setting


def compute(setting: Setting, console: Console) -> tuple[dict[str, Value], monte_carlo.Curve]:
    """All numbers by the keys of expected.json, and the curve of Fig. 2."""
    parts: dict[str, Callable[[], dict[str, Value]]] = {
        "decomposition": lambda: design.decomposition(setting, _report.expected(FOLDER)["printed"]),
        "observability": lambda: design.observability(setting),
        "Theorem 4": lambda: theorem4.ratios(setting),
        "Kalman filter": lambda: monte_carlo.kalman(setting),
        "single-sensor attacks": lambda: monte_carlo.single_attacks(setting),
        "growing attacks": lambda: monte_carlo.growth(setting),
        "Theorem 3": lambda: monte_carlo.theorem3(setting),
    }
    found: dict[str, Value] = {}
    with console.status("simulating") as status:
        for name, part in parts.items():
            status.update(name)
            found |= part()
        status.update("Fig. 2")
        curve, values = monte_carlo.fig2(setting)
    return found | values, curve


def reproduce(size: str, console: Console) -> _program.Result:
    """All numbers and the figure."""
    setting = Setting(size)
    found, curve = compute(setting, console)
    setup = (
        f"Every simulated number comes from {setting.scale['runs']} runs of {setting.scale['steps']} samples "
        "and has its standard error after ±."
    )
    attack = setting.config["fig2"]["attack"]
    return _program.Result(found, setup, lambda: {"fig2.svg": figure.draw(curve, attack)})


def main(arguments: list[str] | None = None) -> int:
    """Run the program; returns its exit code."""
    return _program.run(FOLDER, __doc__, reproduce, arguments)


if __name__ == "__main__":
    sys.exit(main())

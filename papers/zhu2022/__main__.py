"""Reproduce zhu2022, Section 4; exit code 1 if a number of expected.json does not come out."""

from __future__ import annotations

import sys
from collections.abc import Callable

from rich.console import Console

from papers import _program
from papers._report import Value
from papers.zhu2022 import evidence, figure, monte_carlo, scale
from papers.zhu2022.setting import FOLDER, Setting


def compute(setting: Setting, console: Console) -> tuple[dict[str, Value], monte_carlo.Curves]:
    """All numbers by the keys of expected.json, and the curves of the figures."""
    parts: dict[str, Callable[[Setting], dict[str, Value]]] = {
        "gains and correlations": evidence.exact,
        "fits": evidence.counted,
        "the same beliefs": evidence.same_beliefs,
        "starts of mu_1": monte_carlo.starts,
        "sensors that see one axis": scale.partly_seen,
        "hundreds of states": scale.large,
    }
    found: dict[str, Value] = {}
    with console.status("simulating") as status:
        for name, part in parts.items():
            status.update(name)
            found |= part(setting)
        status.update("all estimators")
        squares = monte_carlo.errors(setting)
    found |= monte_carlo.table(squares) | monte_carlo.claims(squares) | monte_carlo.literal(squares)
    return found, monte_carlo.curves(setting, squares)


def reproduce(size: str, console: Console) -> _program.Result:
    """All numbers and the figures."""
    setting = Setting(size)
    found, curves = compute(setting, console)
    choice = setting.config["simulation"]
    setup = (
        f"Mean squared errors come from {setting.scale['plants']} plants with one run of "
        f"{choice['steps'] - choice['start']} attacked samples each, seed {choice['seed']}. Every simulated "
        "number has its standard error after ±."
    )
    return _program.Result(found, setup, lambda: figure.draw(curves))


def main(arguments: list[str] | None = None) -> int:
    """Run the program; returns its exit code."""
    return _program.run(FOLDER, __doc__, reproduce, arguments)


if __name__ == "__main__":
    sys.exit(main())

"""Beyond the paper's scalar systems: sensors that see one axis each, and hundreds of states."""

from __future__ import annotations

from functools import partial

import numpy as np

from papers._report import Value
from papers._statistics import Float, ratio
from papers.zhu2022 import methods
from papers.zhu2022.setting import Setting, confront, stacked
from securestate import OracleFilter, Plant, Sensor
from securestate.attacks import Drawn, RandomNoise
from securestate.attacks.base import Attack

#: Attacks of the table of the planar plant.
PARTIAL = ("25", "26c", "none")


def partly_seen(setting: Setting) -> dict[str, Value]:
    """Mean squared errors over the oracle's where no sensor sees the whole state."""
    work = partial(_partial, setting)
    squares = stacked(setting.each(work, range(setting.scale["partial"])))
    return {
        f"partial.{attack}.{name}": ratio(
            square[:, setting.start :], squares[attack, "oracle"][:, setting.start :]
        )
        for (attack, name), square in squares.items()
        if name != "oracle"
    }


def _partial(setting: Setting, number: int) -> dict[tuple[str, str], Float]:
    plant, attacks = setting.draw(number, "partial-planar"), {key: setting.attacks[key] for key in PARTIAL}
    return confront(plant, methods.partly(setting), attacks, setting.steps, setting.seed, number)


def large(setting: Setting) -> dict[str, Value]:
    """Mean squared errors over the oracle's with hundreds of states and sensors, a third of them attacked."""
    found: dict[str, Value] = {}
    first = setting.config["large"]["from"]
    for size in setting.config["large"]["sizes"]:
        work = partial(_large, setting, size)
        squares = stacked(setting.each(work, range(setting.scale["large"])))
        for name in methods.INNOVATION:
            above, below = (squares["noise", which][:, first:] for which in (name, "oracle"))
            found[f"large.{size}.{name}"] = _ratio(above, below)
    return found


def _ratio(above: Float, below: Float) -> Value:
    """Ratio of means; from a single run, its standard error comes from samples in ten blocks."""
    if len(above) > 1:
        return ratio(above, below)
    blocks = (np.array_split(square[0], 5) for square in (above, below))
    return ratio(*(np.array([[block.mean()] for block in part]) for part in blocks))


def _large(setting: Setting, size: int, number: int) -> dict[tuple[str, str], Float]:
    choice = setting.config["large"]
    plant = random_plant(setting, size, number)
    attacks: dict[str, Attack | None] = {
        "noise": RandomNoise(choice["amplitude"], on=Drawn(round(choice["attacked"] * size)))
    }
    designs = {"oracle": OracleFilter} | methods.INNOVATION
    return confront(plant, designs, attacks, choice["steps"], setting.seed, number)


def random_plant(setting: Setting, size: int, number: int) -> Plant:
    """As many scalar sensors as states, A and C drawn from N(0, 1), A scaled to its spectral radius."""
    choice, rng = setting.config["large"], setting.rng(number)
    A, C = rng.standard_normal((2, size, size))
    A *= choice["radius"] / np.abs(np.linalg.eigvals(A)).max()
    sensors = [Sensor(f"s{i + 1}", C=[row], R=choice["noise"]) for i, row in enumerate(C)]
    return Plant(A, choice["noise"] * np.eye(size), sensors)

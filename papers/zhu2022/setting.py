"""The setting of Section 4: a fresh plant for every run, attacks on sensors that change at every sample."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from multiprocessing import get_context
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.random import Generator, SeedSequence, default_rng
from threadpoolctl import threadpool_limits

from papers._setting import BaseSetting
from papers._statistics import Float
from securestate import Estimator, OracleFilter, Plant
from securestate.attacks import DefenderReflection, NoiseLinear, Redrawn, Reflection
from securestate.attacks.base import Attack
from securestate.simulation import FAMILIES, Simulator

FOLDER = Path(__file__).parent
Design = Callable[[Plant], Estimator | OracleFilter]
Result = TypeVar("Result")
ONE_THREAD = (1, "blas")


@dataclass(frozen=True)
class Setting(BaseSetting):
    """Configuration, attacks and plants of one run of the program."""

    folder = FOLDER

    @property
    def seed(self) -> int:
        return self.config["simulation"]["seed"]

    @property
    def steps(self) -> int:
        return self.config["simulation"]["steps"]

    @property
    def start(self) -> int:
        """Index of the first attacked and first scored sample."""
        return self.config["simulation"]["start"]

    @cached_property
    def attacks(self) -> dict[str, Attack | None]:
        """The paper's two, two variants of the second, and nobody."""
        on, start = Redrawn(tuple(self.config["simulation"]["attacked"])), self.start
        return {
            "25": NoiseLinear(on=on, start=start),
            "26": Reflection("local", on=on, start=start),
            "26c": Reflection("clean-local", on=on, start=start),
            "26f": DefenderReflection(on=on, start=start),
            "none": None,
        }

    def rng(self, number: int) -> Generator:
        """The generator that draws the plant of a run."""
        return default_rng(SeedSequence(self.seed, spawn_key=(number,)))

    def draw(self, number: int, family: str = "scalar") -> Plant:
        """The plant of a run."""
        return FAMILIES[family](self.rng(number))

    def each(self, work: Callable[[int], Result], numbers: Iterable[int]) -> list[Result]:
        """Do the work for all numbers; the full size spreads it over the cores, one thread on each."""
        if self.size == "quick":
            with threadpool_limits(*ONE_THREAD):
                return [work(number) for number in numbers]
        with ProcessPoolExecutor(
            mp_context=get_context("spawn"), initializer=threadpool_limits, initargs=ONE_THREAD
        ) as pool:
            return list(pool.map(work, numbers))


def confront(
    plant: Plant,
    designs: dict[str, Design],
    attacks: dict[str, Attack | None],
    steps: int,
    seed: int,
    number: int,
) -> dict[tuple[str, str], Float]:
    """Squared error of every estimator under every attack in one run, (T,) each.

    The state and the noise of a run are the same under every attack, and so are the attacked sensors.
    """
    simulator = Simulator(plant, steps)
    estimators = {name: design(plant) for name, design in designs.items()}
    errors: dict[tuple[str, str], Float] = {}
    for key, attack in attacks.items():
        trajectory = simulator.run(attack, seed=seed, first_run=number)
        for name, estimator in estimators.items():
            run, met = trajectory.confront(estimator, covariance=False)
            errors[key, name] = np.sum((run.x - met.x) ** 2, axis=-1)[0]
    return errors


def stacked(parts: list[dict[tuple[str, str], Float]]) -> dict[tuple[str, str], Float]:
    """The same keys with all runs, (runs, T) each."""
    return {key: np.stack([part[key] for part in parts]) for key in parts[0]}

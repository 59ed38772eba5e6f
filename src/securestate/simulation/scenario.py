"""What is compared: plants under adversaries, and recipes of estimators, each with an identity of its own."""

from __future__ import annotations

import functools
import itertools
import secrets
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, final

from numpy.random import SeedSequence, default_rng

from securestate._checks import describe, whole_number
from securestate.attacks.base import Attack, SingleAttack
from securestate.errors import InputError
from securestate.estimators import Estimator, OracleFilter
from securestate.plant import Belief, Plant
from securestate.simulation._identity import NamelessError, content, digest, identity
from securestate.simulation.families import PlantFamily
from securestate.simulation.simulate import ADVERSARY
from securestate.simulation.stabilise import stabilised

#: Branch of the random numbers that draw plants of a family; those of a run are NOISE and ADVERSARY.
PLANT = ADVERSARY + 1


@final
@dataclass(frozen=True, eq=False)
class Scenario:
    """A plant under an adversary: independent runs, the same for every estimator.

    Attributes:
        name: unique in a comparison.
        plant: a plant, or a family of which runs get plants of their own.
        attack: the adversary, or None.
        steps: samples per run; score_from: the first one that counts.
        runs: number of runs. seed: of all random numbers.
        prior: belief about x[0], for the truth and for every estimator; None: steady state.
        plant_name, attack_name: for tables.
    """

    name: str
    plant: Plant | PlantFamily
    attack: Attack | None
    steps: int
    runs: int
    seed: int
    score_from: int = 0
    prior: Belief | None = None
    plant_name: str = ""
    attack_name: str = ""

    def __post_init__(self) -> None:
        for argument, least in (("steps", 1), ("runs", 1), ("seed", 0), ("score_from", 0)):
            number = whole_number(argument, getattr(self, argument), least, InputError)
            object.__setattr__(self, argument, number)
        if self.score_from >= self.steps:
            raise InputError("score_from", f"a sample in 0..{self.steps - 1}", repr(self.score_from))
        for argument, kinds, expected in (
            ("plant", Plant | PlantFamily, "a Plant or a PlantFamily"),
            ("attack", Attack | None, "an Attack from securestate.attacks, or None"),
            ("prior", Belief | None, "a Belief, or None for the steady state"),
        ):
            if not isinstance(getattr(self, argument), kinds):
                raise InputError(argument, expected, describe(getattr(self, argument)))
        for part in self.parts:
            if part.start >= self.steps:
                expected = f"a start below {self.steps}, the samples of a run"
                raise InputError(f"attack of scenario {self.name!r}", expected, str(part.start))
        if isinstance(self.plant, Plant) and not self.plant.time_varying:
            object.__setattr__(self, "plant", stabilised(self.plant))

    def plant_of(self, run: int) -> Plant:
        """The plant of one run."""
        if isinstance(self.plant, Plant):
            return self.plant
        number = run // self.plant.runs_per_plant
        rng = default_rng(SeedSequence(self.seed, spawn_key=(number, PLANT)))
        drawn = self.plant.rule(rng)
        return drawn if drawn.time_varying else stabilised(drawn)

    def same_plant(self, first: int, stop: int) -> list[tuple[int, int]]:
        """Split runs first..stop into stretches that share a plant."""
        if isinstance(self.plant, Plant):
            return [(first, stop)]
        size = self.plant.runs_per_plant
        edges = [first, *range((first // size + 1) * size, stop, size), stop]
        return list(itertools.pairwise(edges))

    @functools.cached_property
    def sizes(self) -> tuple[tuple[str, ...], int]:
        """Names of the sensors, and the number of samples."""
        return self.plant_of(0).sensor_names, self.steps

    @functools.cached_property
    def plant_key(self) -> str:
        """Hash of the plant, or of the rule that draws it; names do not count."""
        if isinstance(self.plant, Plant):
            return content(self.plant)
        return digest("family", _key(self.plant.rule), str(self.plant.runs_per_plant))

    def plant_key_of(self, run: int) -> str:
        """Hash of the plant of one run."""
        if isinstance(self.plant, Plant):
            return self.plant_key
        return digest(self.plant_key, str(self.seed), str(run // self.plant.runs_per_plant))

    @functools.cached_property
    def key(self) -> str:
        """Hash of everything that decides the data of a run; the number of runs does not."""
        prior = "steady" if self.prior is None else content(self.prior)
        return digest(self.plant_key, _key(self.parts), prior, repr((self.steps, self.score_from, self.seed)))

    @property
    def parts(self) -> tuple[SingleAttack, ...]:
        """The single adversaries; none if nobody lies."""
        return () if self.attack is None else self.attack.parts

    @property
    def stable(self) -> bool:
        """Whether the key identifies the scenario in another process."""
        rule = None if isinstance(self.plant, Plant) else self.plant.rule
        return _stable((rule, self.parts))


@final
@dataclass(frozen=True)
class Recipe:
    """How an estimator is made for a plant.

    Attributes:
        name: unique in a comparison.
        design: from a plant to an estimator; importable, so that other processes find it.
        settings: keyword arguments of `design`.
    """

    name: str
    design: Callable[..., Estimator | OracleFilter]
    settings: dict[str, Any] = field(default_factory=dict)

    def __call__(self, plant: Plant) -> Estimator | OracleFilter:
        """The estimator for a plant."""
        made: object = self.design(plant, **self.settings)
        if not isinstance(made, Estimator | OracleFilter):
            raise InputError(
                f"estimator {self.name!r}", "a function that returns an Estimator", describe(made)
            )
        return made

    @functools.cached_property
    def key(self) -> str:
        """Hash of the function and its settings; the name does not count."""
        return _key((self.design, self.settings))

    @property
    def stable(self) -> bool:
        """Whether the key identifies the recipe in another process."""
        return _stable((self.design, self.settings))


def _key(value: object) -> str:
    """The identity of a value; of one that has none, a text like no other.

    The keys are made before a scenario or a recipe travels to another process, and travel with it.
    """
    try:
        return identity(value)
    except NamelessError:
        return secrets.token_hex(32)


def _stable(value: object) -> bool:
    try:
        identity(value)
    except NamelessError:
        return False
    return True

"""A comparison described in a TOML file.

    [suite]
    name = "Two tanks"
    runs = 200                  # per scenario
    steps = 130                 # samples per run
    score_from = 30             # first sample that counts, and where attacks start; default 0
    seed = 1

    [[plant]]
    name = "tanks"
    file = "tanks.toml"         # beside this file
    [[plant]]
    name = "scalar"
    family = "scalar"           # drawn at random: a name of `FAMILIES`
    runs_per_plant = 10         # default 1

    [[attack]]                  # one adversary; every other key is an argument of its class
    name = "bias 5"
    kind = "bias"               # a name of `ATTACKS`, or "none"
    size = 5.0
    on = { drawn = 2 }          # who is attacked: see below
    [[attack]]                  # several at once
    name = "bias and silence"
    parts = [{ kind = "bias", size = 5.0, on = "a" }, { kind = "denial", on = "b" }]

    [[scenario]]                # default: every attack on every plant
    plant = "scalar"
    attacks = ["bias 5"]
    on = { redrawn = [1, 6] }   # instead of what the attacks say
    start = 0                   # likewise
    runs = 20                   # fewer than the others, where a run takes long
    prior_variance = 1e4        # x[0] ~ N(0, 1e4 I); default: steady state

    [[estimator]]               # default: every method there is
    name = "sparse 0.9"
    method = "sparse"
    kalman_probability = 0.9    # settings of the method

`on` is a sensor's name, a list of names, or a table: { drawn = 6 } once per run, { redrawn = [1, 6] } at
every sample, { switching = 3, every = 20 }; each with `among = [names]` if not every sensor may be chosen.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, final

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from securestate.attacks import ATTACKS, Drawn, Redrawn, Switching
from securestate.attacks.base import Attack, Combination, SingleAttack
from securestate.attacks.targets import Names, Targets
from securestate.errors import InputError
from securestate.estimators import METHODS
from securestate.plant import Belief, Plant
from securestate.simulation.families import FAMILIES, PlantFamily
from securestate.simulation.scenario import Recipe, Scenario

Count = Annotated[int, Field(ge=0, strict=True)] | tuple[int, int]
Positive = Annotated[int, Field(ge=1, strict=True)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _Open(BaseModel):
    """A table whose other keys are arguments of what it describes."""

    model_config = ConfigDict(extra="allow", frozen=True)


class _Head(_Table):
    runs: Positive
    steps: Positive
    seed: Annotated[int, Field(ge=0, strict=True)]
    name: str = ""
    score_from: Annotated[int, Field(ge=0, strict=True)] = 0


class _Plant(_Table):
    name: str
    file: str | None = None
    family: str | None = None
    runs_per_plant: Positive = 1


class _Choice(_Table):
    """Targets."""

    drawn: Count | None = None
    redrawn: Count | None = None
    switching: Count | None = None
    every: Positive | None = None
    among: list[str] | None = None


_On = str | list[str] | _Choice


class _Part(_Open):
    kind: str
    on: _On | None = None
    start: int | None = None


class _Attack(_Open):
    name: str
    kind: str | None = None
    on: _On | None = None
    start: int | None = None
    parts: list[_Part] | None = None


class _Scenario(_Table):
    plant: str
    attacks: list[str] = Field(min_length=1)
    on: _On | None = None
    start: int | None = None
    runs: Positive | None = None
    prior_variance: Annotated[float, Field(gt=0)] | None = None
    label: str | None = None


class _Estimator(_Open):
    method: str
    name: str | None = None


class _File(_Table):
    suite: _Head
    plant: list[_Plant] = Field(min_length=1)
    attack: list[_Attack] = Field(min_length=1)
    scenario: list[_Scenario] = []
    estimator: list[_Estimator] = []


@final
@dataclass(frozen=True, eq=False)
class Suite:
    """What `campaign` needs: scenarios and recipes. Made by `load_suite`."""

    name: str
    scenarios: tuple[Scenario, ...]
    recipes: tuple[Recipe, ...]


def load_suite(path: str | os.PathLike[str], *, runs: int | None = None) -> Suite:
    """Read the description of a comparison; the format is that of `securestate.simulation.suite`.

    Args:
        runs: instead of the number in the file.

    Raises:
        InputError, PlantError: name the file and the key, what was expected and what came.
    """
    target = Path(path)
    try:
        file = _File.model_validate(tomllib.loads(target.read_text(encoding="utf-8")))
        return _Reader(target.parent, file, runs).suite()
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(str(target), "a readable TOML file", str(error)) from None
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(step + 1) if isinstance(step, int) else step for step in first["loc"])
        raise InputError(f"{target}: {where}", first["msg"], repr(first["input"])[:80]) from None
    except InputError as error:
        raise type(error)(f"{target}: {error.argument}", error.expected, error.received) from None


class _Reader:
    """Turns the tables of a file into scenarios and recipes."""

    def __init__(self, folder: Path, file: _File, runs: int | None) -> None:
        self.folder, self.file = folder, file
        self.runs = file.suite.runs if runs is None else runs
        self.plants = {entry.name: self.plant(entry) for entry in file.plant}
        self.attacks = {entry.name: entry for entry in file.attack}
        for kind, entries in (("plant", file.plant), ("attack", file.attack)):
            if len({entry.name for entry in entries}) < len(entries):
                raise InputError(f"[[{kind}]] name", "names that differ", ", ".join(e.name for e in entries))

    def suite(self) -> Suite:
        """The whole file."""
        every = [_Scenario(plant=plant, attacks=list(self.attacks)) for plant in self.plants]
        scenarios = [one for entry in self.file.scenario or every for one in self.scenarios(entry)]
        recipes = [self.recipe(entry) for entry in self.file.estimator]
        everyone = [Recipe(name, method.design) for name, method in METHODS.items()]
        return Suite(self.file.suite.name, tuple(scenarios), tuple(recipes or everyone))

    def plant(self, entry: _Plant) -> Plant | PlantFamily:
        """A plant from its file, or a family by name."""
        if (entry.file is None) == (entry.family is None):
            raise InputError(
                f"plant {entry.name!r}", "either file or family", "both" if entry.file else "neither"
            )
        if entry.family is not None:
            rule = _known(f"plant {entry.name!r}: family", entry.family, FAMILIES)
            return PlantFamily(entry.family, rule, entry.runs_per_plant)
        return Plant.load(self.folder / str(entry.file))

    def scenarios(self, entry: _Scenario) -> list[Scenario]:
        """One scenario per attack of a table."""
        head, plant = self.file.suite, _known("scenario: plant", entry.plant, self.plants)
        found = []
        for name in entry.attacks:
            described = _known(f"scenario of {entry.plant!r}: attacks", name, self.attacks)
            attack = self.attack(described, entry)
            attack_name = ", ".join([name, *_label(described, entry, attack)])
            found.append(
                Scenario(
                    f"{entry.plant}: {attack_name}",
                    plant,
                    attack,
                    head.steps,
                    self.runs if entry.runs is None else min(self.runs, entry.runs),
                    head.seed,
                    head.score_from,
                    _prior(plant, entry.prior_variance),
                    entry.plant,
                    attack_name,
                )
            )
        return found

    def attack(self, entry: _Attack, scenario: _Scenario) -> Attack | None:
        """The adversary of a table, with what the scenario says instead."""
        where = f"attack {entry.name!r}"
        if (entry.kind is None) == (entry.parts is None):
            raise InputError(where, "either kind or parts", "both" if entry.kind else "neither")
        if entry.kind == "none":
            return None
        if entry.parts is None:
            return self.part(where, str(entry.kind), entry, scenario)
        if entry.model_extra:
            raise InputError(where, "arguments within parts", ", ".join(entry.model_extra))
        return Combination(tuple(self.part(where, part.kind, part, scenario) for part in entry.parts))

    def part(self, where: str, kind: str, entry: _Attack | _Part, scenario: _Scenario) -> SingleAttack:
        """One adversary."""
        family: type[SingleAttack] = _known(f"{where}: kind", kind, ATTACKS)
        given = {name: _tuples(value) for name, value in (entry.model_extra or {}).items()}
        known = [field.name for field in fields(family) if field.name not in ("on", "start")]
        for name in given:
            if name not in known:
                raise InputError(f"{where}: {name}", f"a key among {', '.join(known)}", "another one")
        on = scenario.on if scenario.on is not None else entry.on
        if on is None:
            raise InputError(f"{where}: on", "who is attacked, here or in the scenario", "nothing")
        starts = (scenario.start, entry.start, self.file.suite.score_from)
        start = next(start for start in starts if start is not None)
        try:
            return family(**given, on=_targets(where, on), start=start)
        except TypeError as error:
            raise InputError(where, f"the arguments of {family.__name__}", str(error)) from None
        except InputError as error:
            raise InputError(f"{where}: {error.argument}", error.expected, error.received) from None

    def recipe(self, entry: _Estimator) -> Recipe:
        """An estimator by method and settings."""
        method = _known("estimator: method", entry.method, METHODS)
        settings = dict(entry.model_extra or {})
        for name in settings:
            if name not in method.settings:
                expected = f"a setting of {entry.method} ({', '.join(method.settings) or 'it has none'})"
                raise InputError(f"estimator {entry.name or entry.method!r}: {name}", expected, "another one")
        return Recipe(entry.name or entry.method, method.design, settings)


def _targets(where: str, on: _On) -> Targets | Names:
    """Targets from their table."""
    if not isinstance(on, _Choice):
        return on if isinstance(on, str) else tuple(on)
    rules: dict[str, Any] = {"drawn": on.drawn, "redrawn": on.redrawn, "switching": on.switching}
    given = [(name, count) for name, count in rules.items() if count is not None]
    if len(given) != 1 or (on.every is not None) != (on.switching is not None):
        expected = "one of drawn, redrawn, or switching with every"
        raise InputError(f"{where}: on", expected, str(on.model_dump(exclude_none=True)))
    (name, count), among = given[0], None if on.among is None else tuple(on.among)
    if name == "switching":
        return Switching(count, int(on.every or 1), among=among)
    return Drawn(count, among=among) if name == "drawn" else Redrawn(count, among=among)


def _label(described: _Attack, scenario: _Scenario, attack: Attack | None) -> list[str]:
    """Who is attacked and how it starts, in a few words."""
    if scenario.label is not None:
        return [scenario.label]
    cold = ["cold start"] if scenario.prior_variance is not None else []
    on = scenario.on if scenario.on is not None else described.on
    if attack is None or on is None:
        return cold
    return [_who(on), *cold]


def _who(on: _On) -> str:
    if not isinstance(on, _Choice):
        return "on " + (on if isinstance(on, str) else ", ".join(on))
    counts = {"fixed": on.drawn, "changing": on.redrawn, "switching": on.switching}
    rule, count = next((rule, count) for rule, count in counts.items() if count is not None)
    return f"{'-'.join(map(str, count)) if isinstance(count, tuple) else count} {rule}"


def _prior(plant: Plant | PlantFamily, variance: float | None) -> Belief | None:
    """A belief of this variance in every state; a family's size is that of its first plant."""
    if variance is None:
        return None
    import numpy as np

    n = plant.n if isinstance(plant, Plant) else plant.rule(np.random.default_rng(0)).n
    return Belief(np.zeros(n), variance * np.eye(n))


def _tuples(value: Any) -> Any:
    """Lists as tuples, all the way down, so that adversaries compare by content."""
    return tuple(_tuples(one) for one in value) if isinstance(value, list) else value


def _known(argument: str, name: str, table: Mapping[str, Any]) -> Any:
    if name not in table:
        raise InputError(argument, f"one of {', '.join(table)}", repr(name))
    return table[name]

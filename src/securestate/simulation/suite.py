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

import difflib
import os
import tomllib
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any, final

import numpy as np
from pydantic import ValidationError

from securestate._checks import distinct, whole_number
from securestate.attacks import ATTACKS, Drawn, Redrawn, Switching
from securestate.attacks.base import Attack, Combination, SingleAttack
from securestate.attacks.targets import Names, Targets, as_targets
from securestate.errors import DesignError, InputError, PlantError, ShapeError
from securestate.estimators import METHODS
from securestate.plant import Belief, Plant, Sensor
from securestate.simulation._suite_tables import (
    AttackTable,
    Choice,
    EstimatorTable,
    On,
    PartTable,
    PlantTable,
    ScenarioTable,
    SuiteFile,
    first_mistake,
)
from securestate.simulation.compare import ORACLE
from securestate.simulation.families import FAMILIES, PlantFamily
from securestate.simulation.scenario import Recipe, Scenario

#: Any method can be designed for this plant: a setting that is refused here is wrong.
PLAIN = Plant([[0.9]], [[1.0]], [Sensor(name, C=[1.0], R=1.0) for name in "abc"])


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
    if runs is not None:
        whole_number("runs", runs, 1, InputError)
    target = Path(path)
    try:
        file = SuiteFile.model_validate(_parsed(target))
        return _Reader(target.parent, file, runs).suite()
    except ValidationError as error:
        where, expected, received = first_mistake(error)
        raise InputError(f"{target}: {where}", expected, received) from None
    except InputError as error:
        raise type(error)(f"{target}: {error.argument}", error.expected, error.received) from None


def _parsed(path: Path) -> dict[str, Any]:
    """The tables of a TOML file."""
    try:
        return tomllib.loads(path.read_bytes().decode("utf-8-sig"))
    except RecursionError:
        raise InputError("suite", "a readable TOML file", "brackets nested too deeply") from None
    except (OSError, ValueError) as error:
        raise InputError("suite", "a readable TOML file", str(error)) from None


class _Reader:
    """Turns the tables of a file into scenarios and recipes."""

    def __init__(self, folder: Path, file: SuiteFile, runs: int | None) -> None:
        self.folder, self.file = folder, file
        self.runs = file.suite.runs if runs is None else runs
        distinct("[[plant]] name", [entry.name for entry in file.plant], InputError)
        distinct("[[attack]] name", [entry.name for entry in file.attack], InputError)
        self.plants = {entry.name: self.plant(entry) for entry in file.plant}
        self.attacks = {entry.name: entry for entry in file.attack}
        self.examples = {
            name: plant if isinstance(plant, Plant) else plant.rule(np.random.default_rng(0))
            for name, plant in self.plants.items()
        }

    def suite(self) -> Suite:
        """The whole file."""
        every = [ScenarioTable(plant=plant, attacks=list(self.attacks)) for plant in self.plants]
        scenarios = [one for entry in self.file.scenario or every for one in self.scenarios(entry)]
        distinct("scenarios (plant, attack and label)", [one.name for one in scenarios], InputError)
        everyone = [EstimatorTable(method=name) for name in METHODS]
        recipes = [self.recipe(entry) for entry in self.file.estimator or everyone]
        distinct("[[estimator]] name", [ORACLE, *(recipe.name for recipe in recipes)], InputError)
        return Suite(self.file.suite.name, tuple(scenarios), tuple(recipes))

    def plant(self, entry: PlantTable) -> Plant | PlantFamily:
        """A plant from its file, or a family by name."""
        if (entry.file is None) == (entry.family is None):
            raise InputError(
                f"plant {entry.name!r}", "either file or family", "neither" if entry.file is None else "both"
            )
        if entry.family is not None:
            rule = _known(f"plant {entry.name!r}: family", entry.family, FAMILIES)
            return PlantFamily(entry.family, rule, entry.runs_per_plant)
        try:
            return Plant.load(self.folder / str(entry.file))
        except PlantError as error:
            argument = f"plant {entry.name!r}: {entry.file}: {error.argument}"
            raise PlantError(argument, error.expected, error.received) from None

    def scenarios(self, entry: ScenarioTable) -> list[Scenario]:
        """One scenario per attack of a table."""
        head, plant = self.file.suite, _known("scenario: plant", entry.plant, self.plants)
        found = []
        for name in entry.attacks:
            described = _known(f"scenario of {entry.plant!r}: attacks", name, self.attacks)
            attack = self.attack(described, entry)
            attack_name = ", ".join([name, *_label(described, entry, attack)])
            scenario_name = f"{entry.plant}: {attack_name}"
            self.check_targets(scenario_name, attack, self.examples[entry.plant])
            found.append(
                Scenario(
                    scenario_name,
                    plant,
                    attack,
                    head.steps,
                    self.runs if entry.runs is None else min(self.runs, entry.runs),
                    head.seed,
                    head.score_from,
                    _prior(self.examples[entry.plant], entry.prior_variance),
                    entry.plant,
                    attack_name,
                )
            )
        return found

    def check_targets(self, scenario: str, attack: Attack | None, plant: Plant) -> None:
        """Refuse sensors that the plant lacks or protects."""
        for part in () if attack is None else attack.parts:
            try:
                as_targets(part.on).choose(plant, 1, np.random.default_rng(0))
            except InputError as error:
                argument = f"scenario {scenario!r}: {error.argument}"
                raise InputError(argument, error.expected, error.received) from None

    def attack(self, entry: AttackTable, scenario: ScenarioTable) -> Attack | None:
        """The adversary of a table, with what the scenario says instead."""
        where = f"attack {entry.name!r}"
        if (entry.kind is None) == (entry.parts is None):
            raise InputError(where, "either kind or parts", "neither" if entry.kind is None else "both")
        if entry.kind == "none":
            self.bare(where, entry, "nothing else, because nobody lies")
            return None
        if entry.parts is None:
            return self.part(where, str(entry.kind), entry, scenario)
        self.bare(where, entry, "all other keys within parts")
        return Combination(tuple(self.part(where, part.kind, part, scenario) for part in entry.parts))

    def bare(self, where: str, entry: AttackTable, expected: str) -> None:
        """Refuse arguments of an adversary that has none of its own."""
        given = entry.model_fields_set - {"name", "kind", "parts"}
        if given:
            raise InputError(f"{where}: {min(given)}", expected, "a value")

    def part(
        self, where: str, kind: str, entry: AttackTable | PartTable, scenario: ScenarioTable
    ) -> SingleAttack:
        """One adversary."""
        family: type[SingleAttack] = _known(f"{where}: kind", kind, ATTACKS)
        given = {name: _tuples(value) for name, value in (entry.model_extra or {}).items()}
        own = [field for field in fields(family) if field.name not in ("on", "start")]
        known = [*(field.name for field in own), "on", "start"]
        for name in given:
            if name not in known:
                near = difflib.get_close_matches(name, known, n=1)
                received = f"an unknown key{f'; {near[0]}?' if near else ''}"
                raise InputError(f"{where}: {name}", f"a key among {', '.join(known)}", received)
        for field in own:
            if field.default is MISSING and field.name not in given:
                raise InputError(f"{where}: {field.name}", "a value", "nothing")
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

    def recipe(self, entry: EstimatorTable) -> Recipe:
        """An estimator by method and settings."""
        method = _known("estimator: method", entry.method, METHODS)
        settings = dict(entry.model_extra or {})
        where = f"estimator {entry.name or entry.method!r}"
        for name in settings:
            if name not in method.settings:
                expected = f"a setting of {entry.method} ({', '.join(method.settings) or 'it has none'})"
                raise InputError(f"{where}: {name}", expected, "another one")
        recipe = Recipe(entry.name or entry.method, method.design, settings)
        try:
            recipe(PLAIN)
        except ShapeError:
            pass  # one number per sensor of another plant
        except InputError as error:
            raise InputError(f"{where}: {error.argument}", error.expected, error.received) from None
        except DesignError:
            pass  # may suit another plant
        return recipe


def _targets(where: str, on: On) -> Targets | Names:
    """Targets from their table."""
    if not isinstance(on, Choice):
        return on if isinstance(on, str) else tuple(on)
    (name, count), among = on.rule, None if on.among is None else tuple(on.among)
    try:
        if name == "switching":
            return Switching(count, int(on.every or 1), among=among)
        return Drawn(count, among=among) if name == "drawn" else Redrawn(count, among=among)
    except InputError as error:
        raise InputError(f"{where}: on: {error.argument}", error.expected, error.received) from None


def _label(described: AttackTable, scenario: ScenarioTable, attack: Attack | None) -> list[str]:
    """Who is attacked and how it starts, in a few words."""
    if scenario.label is not None:
        return [scenario.label]
    cold = ["cold start"] if scenario.prior_variance is not None else []
    on = scenario.on if scenario.on is not None else described.on
    if attack is None or on is None:
        return cold
    return [_who(on), *cold]


def _who(on: On) -> str:
    if not isinstance(on, Choice):
        return "on " + (on if isinstance(on, str) else ", ".join(on))
    rule, count = on.rule
    word = {"drawn": "fixed", "redrawn": "changing"}.get(rule, rule)
    return f"{'-'.join(map(str, count)) if isinstance(count, tuple) else count} {word}"


def _prior(plant: Plant, variance: float | None) -> Belief | None:
    """A belief of this variance in every state."""
    return None if variance is None else Belief(np.zeros(plant.n), variance * np.eye(plant.n))


def _tuples(value: Any) -> Any:
    """Lists as tuples, all the way down, so that adversaries compare by content."""
    return tuple(_tuples(one) for one in value) if isinstance(value, list) else value


def _known(argument: str, name: str, table: Mapping[str, Any]) -> Any:
    if name not in table:
        raise InputError(argument, f"one of {', '.join(table)}", repr(name))
    return table[name]

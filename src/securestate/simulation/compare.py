"""Compare estimators under attack, fairly: the same runs for all, and an oracle beside them."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from securestate._checks import describe, distinct, labels
from securestate.attacks.base import Attack
from securestate.errors import InputError
from securestate.estimators import METHODS, Estimator, OracleFilter
from securestate.plant import Belief, Plant
from securestate.simulation._campaign import Progress, cell_key, finish, runs_in
from securestate.simulation._store import FileStore, Kept, MemoryStore, Store
from securestate.simulation._work import groups_of
from securestate.simulation.comparison import Cell, Comparison
from securestate.simulation.families import PlantFamily
from securestate.simulation.metrics import Scores
from securestate.simulation.scenario import Recipe, Scenario

AnyPlant = Plant | PlantFamily
Design = Callable[[Plant], Estimator | OracleFilter]
Estimators = Mapping[str, str | Design] | Sequence[str | Design]
Attacks = Mapping[str, Attack | None] | Sequence[Attack | None] | Attack

#: Name of the filter that knows the attacked set; always in a comparison.
ORACLE = "oracle"


def compare(
    plant: AnyPlant | Mapping[str, AnyPlant],
    estimators: Estimators,
    attacks: Attacks,
    runs: int,
    steps: int,
    seed: int,
    *,
    score_from: int = 0,
    prior: Belief | None = None,
    workers: int | None = None,
    dask: str | None = None,
    out: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """Run estimators on the same simulated runs of plants under attack.

    Args:
        plant: a plant, a family of plants, or several of them by name. One whose state grows gets a known
            input that holds it (`stabilised`).
        estimators: names of methods ("kalman", "sparse", ...), or functions from a plant to an estimator,
            such as `KalmanFilter` or `functools.partial(SparseFusion, gamma=2.0)`; as a list, or by the names
            that the table shall show. The oracle, told who lies, is always there too, and "protected" beside
            "joint".
        attacks: adversaries by name or as a list; None stands for nobody.
        runs, steps: runs per scenario and samples per run.
        seed: of all random numbers; the same seed gives the same numbers, whoever computes them.
        score_from: first sample that counts.
        prior: belief about x[0], for the truth and for every estimator.
        workers: threads (processes with `dask="local"`); default: one per core.
        dask: "local" for a cluster of processes on this machine, or the address of a dask scheduler.
        out: folder that keeps what is computed; a comparison that was interrupted goes on from there. What is
            kept counts for this version of the package, and for functions and adversaries of your own as long
            as their own source stays the same, whatever they call.
        progress: called with the number of groups of runs done and of all.
    Returns:
        Comparison: a labelled table, figures, and what could not run and why.
    Raises:
        InputError: naming the argument, expected and received.
        DesignError: a plant under an adversary cannot be simulated; names the scenario.
    Examples:
        >>> from securestate.attacks import Bias
        >>> from securestate.plant import Sensor
        >>> plant = Plant([[0.9]], [[1.0]], [Sensor(s, C=[1.0], R=1.0) for s in "abcde"])
        >>> attacks = {"bias": Bias(20.0, on="b")}
        >>> result = compare(plant, ["kalman", "sparse"], attacks, runs=20, steps=50, seed=1)
        >>> print(result.table.ratio.sel(scenario="bias").to_series().round(1).to_dict())
        {'oracle': 1.0, 'kalman': 76.3, 'sparse': 1.0}
    """
    recipes, scenarios = recipes_of(estimators), []
    for plant_name, one in _plants(plant).items():
        for attack_name, attack in _attacks(attacks).items():
            name = attack_name if not isinstance(plant, Mapping) else f"{plant_name}: {attack_name}"
            scenarios.append(
                Scenario(name, one, attack, steps, runs, seed, score_from, prior, plant_name, attack_name)
            )
    return campaign(scenarios, recipes, workers=workers, dask=dask, out=out, progress=progress)


def campaign(
    scenarios: Sequence[Scenario],
    recipes: Sequence[Recipe],
    *,
    workers: int | None = None,
    dask: str | None = None,
    out: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """As `compare`, for any list of scenarios; the oracle is added to the recipes.

    Raises:
        InputError: names that occur twice, nothing to compare, a recipe that `out` could not recognise again.
    """
    recipes = [Recipe(ORACLE, OracleFilter), *recipes]
    for argument, names in (
        ("scenarios", [scenario.name for scenario in scenarios]),
        ("estimators", [recipe.name for recipe in recipes]),
    ):
        distinct(argument, labels(argument, names, None, InputError), InputError)
    if not scenarios:
        raise InputError("scenarios", "one at least", "none")
    store = _open(out, scenarios, recipes)
    try:
        finish(scenarios, recipes, store, workers=workers, dask=dask, progress=progress)
        cells = {(s.name, r.name): _cell(s, store.get(cell_key(s, r))) for s in scenarios for r in recipes}
    finally:
        store.close()
    return Comparison.of(scenarios, recipes, cells)


def recipes_of(estimators: Estimators) -> list[Recipe]:
    """Recipes from names of methods, classes and functions."""
    if isinstance(estimators, Mapping):
        recipes = [_recipe(name, design) for name, design in estimators.items()]
    elif isinstance(estimators, list | tuple):
        recipes = [_recipe(None, design) for design in estimators]
    else:
        raise InputError("estimators", "a list, or several by name", describe(estimators))
    return [*recipes, *_beside(recipes)]


def _beside(recipes: Sequence[Recipe]) -> list[Recipe]:
    """Methods that belong beside those chosen and are not among them."""
    chosen = [getattr(recipe.design, "func", recipe.design) for recipe in recipes]
    asked = {method.beside for method in METHODS.values() if method.beside and method.design in chosen}
    return [_recipe(None, name) for name in sorted(asked) if METHODS[name].design not in chosen]


def _recipe(name: str | None, design: str | Design) -> Recipe:
    if isinstance(design, str):
        if design not in METHODS:
            raise InputError("estimators", f"one of {', '.join(METHODS)}", repr(design))
        return Recipe(name or design, METHODS[design].design)
    if not callable(design):
        raise InputError("estimators", "names of methods, or functions from a plant", repr(design))
    return Recipe(name or _called(design), design)


def _called(design: Any) -> str:
    """A short name: of a partial function, its own and what is bound."""
    if isinstance(design, functools.partial):
        bound = [*map(repr, design.args), *(f"{key}={value!r}" for key, value in design.keywords.items())]
        return f"{_called(design.func)}({', '.join(bound)})"
    return str(getattr(design, "__name__", repr(design)))


def _plants(plant: AnyPlant | Mapping[str, AnyPlant]) -> Mapping[str, AnyPlant]:
    plants = plant if isinstance(plant, Mapping) else {getattr(plant, "name", "") or "plant": plant}
    for one in plants.values():
        if not isinstance(one, Plant | PlantFamily):
            raise InputError("plant", "a Plant, a PlantFamily, or several by name", type(one).__name__)
    return plants


def _attacks(attacks: Attacks) -> Mapping[str, Attack | None]:
    if isinstance(attacks, Mapping):
        return attacks
    several: object = [attacks] if isinstance(attacks, Attack) else attacks
    if not isinstance(several, list | tuple):
        raise InputError("attacks", "an Attack, a list, or several by name", describe(attacks))
    names = [_attack_name(one) for one in several]
    twice = {name for name in names if names.count(name) > 1}
    return {
        f"{name} {i}" if name in twice else name: one
        for i, (name, one) in enumerate(zip(names, several, strict=True), 1)
    }


def _attack_name(attack: Attack | None) -> str:
    parts = attack.parts if isinstance(attack, Attack) else (attack,)
    return "none" if attack is None else " + ".join(type(part).__name__ for part in parts)


def _open(
    out: str | os.PathLike[str] | None, scenarios: Sequence[Scenario], recipes: Sequence[Recipe]
) -> Store:
    if out is None:
        return MemoryStore()
    known = "that can be recognised in another process, because out is given (no lambda, no local function)"
    for recipe in recipes:
        if not recipe.stable:
            raise InputError("estimators", f"functions and settings {known}", repr(recipe.name))
    for scenario in scenarios:
        if not scenario.stable:
            raise InputError("scenarios", f"adversaries and families {known}", repr(scenario.name))
    try:
        Path(out).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError("out", "a folder that can be written", str(error)) from None
    return FileStore(Path(out))


def _cell(scenario: Scenario, kept: Sequence[Kept]) -> Cell:
    """Everything that is kept of one estimator in one scenario."""
    groups = groups_of(scenario)
    wanted = [one for one in kept if one.group in groups and one.runs == runs_in(scenario, one.group)]
    refusal = next((one.refusal for one in wanted if one.refusal), "")
    timings = [one.microseconds for one in wanted if one.microseconds is not None]
    fastest = min(timings, default=float("nan"))
    if refusal:
        return Cell(None, refusal, fastest)
    sensors, steps = scenario.sizes
    scores = [Scores.unpack(one.scores, len(sensors), steps) for one in wanted]
    return Cell(Scores.join(scores), "", fastest)

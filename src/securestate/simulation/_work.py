"""The work of a comparison: estimators on groups of runs, for about as long as asked, anywhere."""

from __future__ import annotations

import os
import threading
import time
import warnings
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

from securestate._threads import one_blas_thread
from securestate.errors import DesignError, InputError, SecurestateError, SecurestateWarning
from securestate.estimators import Estimator, OracleFilter
from securestate.plant import Plant
from securestate.simulation._identity import code_key, digest
from securestate.simulation.metrics import Scores, score
from securestate.simulation.scenario import Recipe, Scenario
from securestate.simulation.simulate import Simulator
from securestate.simulation.trajectory import Trajectory

Key = TypeVar("Key", bound=Hashable)
Value = TypeVar("Value")

#: Runs of a group: what is computed, kept and resumed together.
GROUP = 10
#: Seconds after which a task hands back what is left.
SLICE = 0.5
#: Times a single run is timed; the fastest counts.
TIMINGS = 3
#: Designs and simulators kept per process.
KEPT = 512


@dataclass(frozen=True)
class Task:
    """Estimators to run on groups of one scenario. `code` is the hash of the code that asks for it."""

    scenario: Scenario
    recipes: tuple[Recipe, ...]
    groups: tuple[int, ...]
    code: str


@dataclass(frozen=True)
class Done:
    """One estimator on one group: packed scores, or why it cannot run here.

    `microseconds` per step of one live filter, measured on the first group, otherwise None.
    """

    recipe: str
    group: int
    scores: bytes
    refusal: str = ""
    microseconds: float | None = None


def groups_of(scenario: Scenario) -> range:
    """Numbers of the groups of a scenario."""
    return range(-(-scenario.runs // GROUP))


def work(task: Task, *, alone: bool, budget: float = SLICE) -> tuple[list[Done], tuple[int, ...]]:
    """Do groups of a task until the time is over, one at least; returns what is done and the groups left.

    Args:
        alone: this process has one thread to itself, as the worker of a cluster does.

    Raises:
        InputError: this process runs other code than the one that asks, or a scenario cannot be simulated.
    """
    if task.code != code_key():
        raise InputError("dask", "workers with the same version of securestate", "a worker with another one")
    if alone:
        os.environ.setdefault("RAYON_NUM_THREADS", "1")
        warnings.simplefilter("ignore", SecurestateWarning)  # the table says how an estimator fared
    begin, done = time.perf_counter(), list[Done]()
    with one_blas_thread():
        for position, group in enumerate(task.groups):
            done += _group(task, group)
            if time.perf_counter() - begin >= budget:
                return done, task.groups[position + 1 :]
    return done, ()


def _group(task: Task, group: int) -> Iterator[Done]:
    """Every estimator on one group of runs."""
    scenario, stop = task.scenario, min((group + 1) * GROUP, task.scenario.runs)
    parts: dict[str, list[Scores]] = {recipe.key: [] for recipe in task.recipes}
    refusals: dict[str, str] = {}
    timings: dict[str, float] = {}
    for first, end in scenario.same_plant(group * GROUP, stop):
        trajectory = _simulated(scenario, first, end)
        for recipe in task.recipes:
            if recipe.key in refusals:
                continue
            try:
                estimator = _design(recipe, scenario, first, trajectory.plant)
                run, met = trajectory.confront(estimator)
                parts[recipe.key].append(score(run, met, scenario.score_from))
                if first == 0:
                    timings[recipe.key] = _microseconds(estimator, met)
            except SecurestateError as refusal:
                refusals[recipe.key] = str(refusal)
    for recipe in task.recipes:
        if recipe.key in refusals:
            yield Done(recipe.key, group, b"", refusals[recipe.key])
        else:
            packed = Scores.join(parts[recipe.key]).pack()
            yield Done(recipe.key, group, packed, microseconds=timings.get(recipe.key))


def _simulated(scenario: Scenario, first: int, stop: int) -> Trajectory:
    """Runs first..stop, which have a plant in common.

    Raises:
        InputError, DesignError: they cannot be simulated; names the scenario.
    """
    try:
        simulator = _simulator(scenario, first)
        return simulator.run(scenario.attack, seed=scenario.seed, runs=stop - first, first_run=first)
    except InputError as error:
        argument = f"scenario {scenario.name!r}: {error.argument}"
        raise type(error)(argument, error.expected, error.received) from None
    except DesignError as error:
        raise DesignError(f"scenario {scenario.name!r}: {error.reason}", error.advice) from None


def _microseconds(estimator: Estimator | OracleFilter, met: Trajectory) -> float:
    """Time per sample of one filter over the first run."""
    one = replace(
        met,
        x=met.x[:1],
        u=met.u[:1],
        clean=met.clean[:1],
        y=met.y[:1],
        a=met.a[:1],
        attacked=met.attacked[:1],
    )
    best = float("inf")
    for _ in range(TIMINGS):
        begin = time.perf_counter()
        one.confront(estimator, covariance=False)
        best = min(best, time.perf_counter() - begin)
    return 1e6 * best / met.steps


class _Kept(Generic[Key, Value]):
    """Values of this process by what identifies them, each made once, even if several threads ask at once."""

    def __init__(self) -> None:
        self._slots: dict[Key, tuple[threading.Lock, list[Value]]] = {}

    def get(self, key: Key, make: Callable[[], Value]) -> Value:
        """The value of a key; the oldest one is forgotten when there are too many."""
        if key not in self._slots and len(self._slots) >= KEPT:
            self._slots.pop(next(iter(self._slots)), None)
        lock, held = self._slots.setdefault(key, (threading.Lock(), []))
        with lock:
            if not held:
                held.append(make())
            return held[0]


_simulators: _Kept[str, Simulator] = _Kept()
_designs: _Kept[tuple[str, str], Estimator | OracleFilter] = _Kept()


def _simulator(scenario: Scenario, run: int) -> Simulator:
    """The simulator of a run's plant; kept, since others of its runs may follow."""
    key = digest(scenario.plant_key_of(run), scenario.key)
    return _simulators.get(key, lambda: Simulator(scenario.plant_of(run), scenario.steps, scenario.prior))


def _design(recipe: Recipe, scenario: Scenario, run: int, plant: Plant) -> Estimator | OracleFilter:
    """The estimator for a run's plant; kept, since other scenarios may have the same plant."""
    return _designs.get((scenario.plant_key_of(run), recipe.key), lambda: recipe(plant))

"""Small comparisons that have everything in them, and what counts as the same result."""

import time
from pathlib import Path

import numpy as np
import pytest

import securestate as ss
from securestate.attacks import (
    ATTACKS,
    Bias,
    DefenderReflection,
    Drawn,
    NoiseLinear,
    RandomNoise,
    Redrawn,
)
from securestate.simulation import Comparison, PlantFamily, Recipe, Scenario, _campaign, _work

PLANT = ss.Plant([[0.9]], [[1.0]], [ss.Sensor(name, C=[1.0], R=1.0) for name in "abcde"], name="five")


def any_plant(rng: np.random.Generator) -> ss.Plant:
    """Draw a plant with one state and four sensors."""
    sensors = [ss.Sensor(name, C=[rng.uniform(1, 2)], R=1.0) for name in "abcd"]
    return ss.Plant([[rng.uniform(0.4, 0.9)]], [[1.0]], sensors)


FAMILY = PlantFamily("any", any_plant, runs_per_plant=3)


def scenarios(runs: int, steps: int = 20) -> list[Scenario]:
    """Return a fixed plant, a family, drawn targets and an adversary that reacts."""
    start = {"start": 5}
    drawn = Bias(5.0, on=Drawn(1), **start)
    hidden = NoiseLinear(on=Redrawn((1, 2)), **start)
    return [
        Scenario("nobody", PLANT, None, steps, runs, seed=1, score_from=5),
        Scenario("bias", PLANT, Bias(20.0, on="b", **start), steps, runs, seed=1, score_from=5),
        Scenario("drawn", FAMILY, drawn, steps, runs, seed=1, score_from=5),
        Scenario("redrawn", FAMILY, hidden, steps, runs, seed=2, score_from=5),
        Scenario("reacts", PLANT, DefenderReflection(on=["a", "c"], **start), steps, runs, seed=1),
    ]


def recipes() -> list[Recipe]:
    """Return two estimators."""
    return [Recipe("kalman", ss.KalmanFilter), Recipe("sparse", ss.SparseFusion, {"kalman_probability": 0.9})]


def unhurried(plant: ss.Plant) -> ss.KalmanFilter:
    """Take a while to design a Kalman filter, without work for the processor."""
    time.sleep(0.1)
    return ss.KalmanFilter(plant)


def assert_same(first: Comparison, second: Comparison) -> None:
    """Every number to the bit, NaN equal to NaN, in the same places."""
    assert list(first.table.variables) == list(second.table.variables)
    for name, held in first.table.variables.items():
        other = second.table.variables[name]
        assert held.dims == other.dims
        if held.dtype.kind == "f":
            assert held.values.tobytes() == other.values.tobytes(), name
        else:
            assert held.values.tolist() == other.values.tolist(), name
    assert first.sensors.equals(second.sensors)


def saved(result: Comparison, folder: Path) -> dict[str, bytes]:
    """Return the files whose bytes do not depend on who computed them."""
    return {path.name: path.read_bytes() for path in result.save(folder) if path.name != "timing.csv"}


class Counter:
    """Counts the groups that are computed, while it is installed."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.done: list[tuple[str, str, int]] = []

        def work(task: _work.Task, **options: bool) -> _campaign.Outcome:
            results, left = _work.work(task, **options)
            self.done += [(task.scenario.key, result.recipe, result.group) for result in results]
            return results, left

        monkeypatch.setattr(_campaign, "work", work)


def keys() -> dict[str, str]:
    """Return keys that another process must find again."""
    needed = {
        "bias": {"size": np.arange(5.0)},
        "delay": {"samples": 2},
        "fake-state": {"shift": [1.0]},
        "pulse": {"size": 1.0},
        "ramp": {"slope": [1.0] * 5},
        "random-noise": {"covariance": np.eye(5)},
        "random-walk": {"std": 1.0},
        "replay": {"length": 2},
        "scale": {"factor": 2.0},
        "sinusoid": {"amplitude": 1.0, "period": 4},
        "worst-case": {"size": 1.0},
    }
    attacks = {name: kind(**needed.get(name, {}), on="b", start=3) for name, kind in ATTACKS.items()}
    attacks["several"] = RandomNoise([1.0] * 5, on=Drawn((1, 2), among=["a", "b"])) + attacks["bias"]
    found = {
        name: Scenario(name, PLANT, attack, 9, 9, 1, prior=ss.Belief([0.0], [[2.0]])).key
        for name, attack in attacks.items()
    }
    found["family"] = Scenario("family", FAMILY, None, 9, 9, 1).key
    found |= {recipe.name: recipe.key for recipe in recipes()}
    found["array"] = Recipe("array", unhurried, {"weights": np.arange(5000.0)}).key
    return found

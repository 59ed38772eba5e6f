"""Comparisons made up for their report: chosen ratios to the oracle, without running anything."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from securestate.attacks import Bias
from securestate.estimators import KalmanFilter
from securestate.plant import Plant, Sensor
from securestate.simulation import Comparison, Recipe, Scenario
from securestate.simulation.comparison import Cell
from securestate.simulation.metrics import PER_RUN, PER_SENSOR, Scores

STEPS, SCORE_FROM, RUNS, SEED = 50, 10, 4, 7
ORACLE_MSE = 2.0


def made_comparison(
    ratios: Mapping[str, Sequence[float | str]],
    *,
    plants: Sequence[str] = ("tank",),
    attacks: Sequence[str] = ("none", "bias"),
    sensors: Sequence[str] = ("level", "flow"),
    oracle: Sequence[float | str] | None = None,
    runs: int = RUNS,
    spread: float = 0.01,
) -> Comparison:
    """Every adversary on every plant; the one that is called "none" is nobody.

    Args:
        ratios: per estimator the ratio to the oracle in every scenario, or the reason why it cannot run.
        oracle: the same for the oracle; default 1 everywhere.
        spread: how far the runs lie apart, relative to their mean.
    """
    plant = Plant([[0.9]], [[1.0]], [Sensor(name, C=[1.0], R=1.0) for name in sensors])
    scenarios = [
        Scenario(
            f"{p}: {a}", plant, None if a == "none" else Bias(5.0, on=0), STEPS, runs, SEED, SCORE_FROM,
            plant_name=p, attack_name=a,
        )
        for p in plants
        for a in attacks
    ]  # fmt: skip
    values = {"oracle": oracle or [1.0] * len(scenarios), **ratios}
    cells = {
        (scenario.name, name): _cell(row[i], scenario, len(sensors), spread if name != "oracle" else 0.0)
        for name, row in values.items()
        for i, scenario in enumerate(scenarios)
    }
    return Comparison.of(scenarios, [Recipe(name, KalmanFilter) for name in values], cells)


def _cell(ratio: float | str, scenario: Scenario, sensors: int, spread: float) -> Cell:
    if isinstance(ratio, str):
        return Cell(None, ratio, float("nan"))
    mse = ORACLE_MSE * ratio
    lies = 40.0 if scenario.attack else 0.0
    run = dict.fromkeys(PER_RUN, 0.0) | {
        "nees": 1.25, "nis": 0.75, "honest": 80.0 - lies, "false_alarms": 2.0, "lies": lies,
        "detections": lies / 4, "delay": 3.0 if scenario.attack else np.nan, "exact": 0.625,
    }  # fmt: skip
    runs = np.tile(np.array(list(run.values())), (scenario.runs, 1))
    runs[:, 0] = mse * (1 + spread * np.linspace(-1, 1, scenario.runs)) if scenario.runs > 1 else mse
    counts = np.outer([run[name] for name in PER_SENSOR], np.full(sensors, scenario.runs / sensors))
    return Cell(Scores(runs, counts, np.full((2, STEPS), mse * scenario.runs)), "", 2.5)

"""The rows of the table of Zhu et al. 2022 that need no mixture, against an independent program."""

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from securestate import ChiSquareFilter, InnovationGate, KalmanFilter
from securestate.attacks import NoiseLinear, Redrawn, Reflection
from securestate.simulation import FAMILIES, Comparison, PlantFamily, compare

TABLE = json.loads((Path(__file__).parents[1] / "cases/mixture/table.json").read_text())
#: Consecutive runs that share a plant, so that designing takes seconds; their errors are not independent.
SHARED = 10

ESTIMATORS = {
    "kalman": KalmanFilter,
    "gate": InnovationGate,
    "sensor, drop": partial(ChiSquareFilter, scope="sensor"),
    "sensor, hold": partial(ChiSquareFilter, scope="sensor", on_alarm="hold"),
    "central, predict": partial(ChiSquareFilter, scope="central"),
    "central, drop-worst": partial(ChiSquareFilter, scope="central", on_alarm="drop-worst"),
}


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    changing = {"on": Redrawn((1, 6)), "start": 30}
    attacks = {
        "none": None,
        "(25)": NoiseLinear(**changing),
        "(26)": Reflection(**changing),
        "(26) about a clean filter": Reflection("clean-local", **changing),
    }
    family = PlantFamily("scalar", FAMILIES["scalar"], SHARED)
    return compare(family, ESTIMATORS, attacks, runs=500, steps=130, seed=2022, score_from=30)


@pytest.mark.parametrize("estimator", ["oracle", *ESTIMATORS])
@pytest.mark.parametrize("attack", list(TABLE))
def test_the_mean_squared_error_is_that_of_an_independent_program(
    comparison: Comparison, attack: str, estimator: str
) -> None:
    ours = comparison.table.sel(scenario=attack, estimator=estimator)
    theirs = TABLE[attack][estimator]
    error = (float(ours.mse_high) - float(ours.mse_low)) / 2 / 1.96 * np.sqrt(SHARED)
    assert abs(float(ours.mse) - theirs["mse"]) <= 4 * np.hypot(error, theirs["error"])


def test_the_orderings_of_the_table_hold(comparison: Comparison) -> None:
    mse = comparison.table.mse.to_pandas()
    attacked = mse.drop(index="none")
    assert (attacked["gate"] < attacked["kalman"]).drop(index="(26) about a clean filter").all()
    assert (
        attacked["central, predict"] > attacked["kalman"]
    ).all()  # giving up on a sample is worse than lies
    assert mse.loc["none"].idxmin() in ("oracle", "kalman")

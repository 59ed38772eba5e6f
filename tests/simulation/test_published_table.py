"""The rows of the table of Zhu et al. 2022 that need no mixture, against an independent program."""

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from securestate import ChiSquareFilter, InnovationGate, KalmanFilter, OracleFilter
from securestate.attacks import NoiseLinear, Redrawn, Reflection
from securestate.simulation import FAMILIES, PlantFamily, Recipe, Scenario
from securestate.simulation._campaign import cell_key, finish
from securestate.simulation._store import Kept, MemoryStore
from securestate.simulation._work import GROUP
from securestate.simulation.compare import recipes_of
from securestate.simulation.metrics import PER_RUN, Scores

Float = NDArray[np.float64]
TABLE = json.loads((Path(__file__).parents[1] / "cases/mixture/table.json").read_text())
#: Runs that share a plant, so that designing takes seconds: one group of the campaign.
SHARED = GROUP

ESTIMATORS = {
    "kalman": KalmanFilter,
    "gate": InnovationGate,
    "sensor, drop": partial(ChiSquareFilter, scope="sensor"),
    "sensor, hold": partial(ChiSquareFilter, scope="sensor", on_alarm="hold"),
    "central, predict": partial(ChiSquareFilter, scope="central"),
    "central, drop-worst": partial(ChiSquareFilter, scope="central", on_alarm="drop-worst"),
}
CHANGING = {"on": Redrawn((1, 6)), "start": 30}
ATTACKS = {
    "none": None,
    "(25)": NoiseLinear(**CHANGING),
    "(26)": Reflection(**CHANGING),
    "(26) about a clean filter": Reflection("clean-local", **CHANGING),
}


@pytest.fixture(scope="module")
def errors() -> dict[tuple[str, str], Float]:
    """Mean squared error of every plant, (50,): plants are independent, the runs that share one are not."""
    family, store = PlantFamily("scalar", FAMILIES["scalar"], SHARED), MemoryStore()
    scenarios = [Scenario(name, family, attack, 130, 500, 2022, 30) for name, attack in ATTACKS.items()]
    recipes = [Recipe("oracle", OracleFilter), *recipes_of(ESTIMATORS)]
    finish(scenarios, recipes, store)

    def plant(kept: Kept) -> float:
        return float(Scores.unpack(kept.scores, 15, 130).per_run[:, PER_RUN.index("mse")].mean())

    return {
        (scenario.name, recipe.name): np.array([plant(k) for k in store.get(cell_key(scenario, recipe))])
        for scenario in scenarios
        for recipe in recipes
    }


@pytest.mark.parametrize("estimator", ["oracle", *ESTIMATORS])
@pytest.mark.parametrize("attack", list(TABLE))
def test_the_mean_squared_error_is_that_of_an_independent_program(
    errors: dict[tuple[str, str], Float], attack: str, estimator: str
) -> None:
    ours, theirs = errors[attack, estimator], TABLE[attack][estimator]
    assert len(ours) == 50
    error = ours.std(ddof=1) / np.sqrt(len(ours))
    assert abs(ours.mean() - theirs["mse"]) <= 4 * np.hypot(error, theirs["error"])


def test_the_orderings_of_the_table_hold(errors: dict[tuple[str, str], Float]) -> None:
    mse = {cell: values.mean() for cell, values in errors.items()}
    for attack in ("(25)", "(26)"):
        assert mse[attack, "gate"] < mse[attack, "kalman"]
    for attack in list(ATTACKS)[1:]:  # giving up on a sample is worse than lies
        assert mse[attack, "central, predict"] > mse[attack, "kalman"]
    assert min((mse["none", name], name) for name in ESTIMATORS)[1] == "kalman"

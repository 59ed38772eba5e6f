"""The innovation mixture equals two independent programs and a textbook, step by step."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from securestate import Belief, InnovationMixture, KalmanFilter, Plant, Run, Sensor, Status
from tests.estimators.mixture_cases import attacked_data, random_plant, some_prior
from tests.reference import innovation_mixture as book

CASES = Path(__file__).parents[1] / "cases/mixture"
GOLDEN = json.loads((CASES / "golden.json").read_text())
PROPAGATION = json.loads((CASES / "propagation.json").read_text())

# ---------------------------------------------------------------- independent programs

WEIGHTING: dict[str, dict[str, Any]] = {
    "run_secure_learn": {"kappa": 4.0, "forgetting": 0.97, "memory": "doubt"},
    "run_secure_t": {"memory": "doubt", "attacked": "student", "kappa": 9.0, "forgetting": 0.9},
}


@pytest.mark.parametrize("name", WEIGHTING)
def test_belief_weighting_is_that_of_an_independent_program(name: str) -> None:
    A, Q, C, R = (GOLDEN["system"][letter] for letter in "AQCR")
    sensors = [Sensor(f"s{i}", C=[c], R=r) for i, (c, r) in enumerate(zip(C, R, strict=True))]
    plant, start, y = Plant([A], [Q], sensors), GOLDEN["T0"], np.array(GOLDEN["y"], dtype=float)
    before = KalmanFilter(plant).run(y[:start])
    assert before.P is not None
    belief = Belief(plant.A @ before.x[-1], plant.A @ before.P[-1] @ plant.A.T + plant.Q)
    run = InnovationMixture(plant, form="belief", merge=False, **WEIGHTING[name]).run(y[start:], prior=belief)
    assert run.P is not None
    expected = GOLDEN[name]
    np.testing.assert_allclose(run.x[:, 0], expected["xhat"][start:], rtol=0, atol=1e-12)
    np.testing.assert_allclose(run.P[:, 0, 0], expected["P"][start:], rtol=0, atol=1e-12)
    np.testing.assert_allclose(run.trust, expected["gamma"], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(run.suspected, np.array(expected["gamma"]) < 0.5)


@pytest.mark.parametrize("memory", ["beta", "sticky"])
@pytest.mark.parametrize("case", PROPAGATION, ids=lambda case: f"{case['n']}-{case['N']}")
def test_expectation_propagation_is_that_of_an_independent_program(case: dict[str, Any], memory: str) -> None:
    n, A, expected = case["n"], np.array(case["A"]), case[memory]
    sensors = [Sensor(f"s{i}", C=c, R=r) for i, (c, r) in enumerate(zip(case["C"], case["r"], strict=True))]
    plant = Plant(A, case["q"] * np.eye(n), sensors)
    estimator = InnovationMixture(
        plant, merge=False, kappa=4.0, forgetting=0.97, memory="doubt" if memory == "beta" else "sticky"
    )
    run = estimator.run(case["y"], prior=Belief(np.zeros(n), A @ A.T + plant.Q))
    np.testing.assert_allclose(run.x, expected["x"], rtol=0, atol=1e-10)
    np.testing.assert_allclose(run.x_std**2, expected["variance"], rtol=0, atol=1e-10)
    np.testing.assert_allclose(run.trust, expected["gamma"], rtol=0, atol=1e-10)


# ---------------------------------------------------------------- the textbook

SETTINGS: list[dict[str, Any]] = [
    {},
    {"merge": False},
    {"memory": "sticky"},
    {"memory": "doubt"},
    {"attacked": "student", "kappa": 9.0, "memory": "sticky", "forgetting": 0.9},
    {"form": "belief", "kappa": 4.0},
    {"form": "belief", "attacked": "student", "merge": False},
    {"monitor": 0.8, "monitor_rate": 0.02},
    {"form": "belief", "monitor": 0.7, "monitor_rate": 0.05, "memory": "sticky"},
]


def assert_equals_textbook(run: Run, expected: book.Textbook, tolerance: float = 1e-8) -> None:
    """Nothing was decided by rounding: no gap, belief, evidence or weight was within 1e-7 of a bound."""
    assert expected.margin > 1e-7
    assert run.P is not None
    plant, scale = run.plant, run.plant.scale
    np.testing.assert_allclose(run.x, expected.x, rtol=0, atol=tolerance * np.abs(expected.x).max())
    np.testing.assert_allclose(run.P, expected.P, rtol=0, atol=tolerance * np.abs(expected.P).max())
    np.testing.assert_allclose(run.x_std, np.sqrt(np.diagonal(expected.P, axis1=1, axis2=2)), rtol=tolerance)
    np.testing.assert_allclose(run.trust, expected.trust, rtol=0, atol=tolerance)
    np.testing.assert_array_equal(run.suspected, expected.trust < 0.5)
    attack, std = expected.attack * scale, expected.attack_std * scale
    np.testing.assert_allclose(run.attack, attack, rtol=0, atol=tolerance * np.nanmax(np.abs(attack)))
    np.testing.assert_allclose(run.attack_std, std, rtol=tolerance)
    np.testing.assert_array_equal(run.status, expected.status)
    for name, values in expected.diagnostics.items():
        np.testing.assert_allclose(run.diagnostics[name], values, rtol=0, atol=1e-8, err_msg=name)
    assert run.suspected[:, ~plant.protected].any() and not run.suspected[:, plant.protected].any()


@pytest.mark.parametrize(("n", "settings"), [(1 + i % 5, SETTINGS[i % 8]) for i in range(0, 40, 3)], ids=str)
def test_sensors_of_all_kinds_with_inputs_and_gaps_equal_the_textbook(
    n: int, settings: dict[str, Any]
) -> None:
    T, varying = 30, n % 2 == 0
    plant = random_plant(n, n, varying=T if varying else None, protected=("s6",) if n != 3 else ())
    y, u = attacked_data(plant, T, n + 10, missing=0.15 if n > 1 else 0.0)
    prior = some_prior(plant)
    assert prior.P is not None
    run = InnovationMixture(plant, **settings).run(y, u, prior)
    expected = book.innovation_mixture(plant, plant.normalise(y), u, prior.x, prior.P, **settings)
    assert_equals_textbook(run, expected)


@pytest.mark.parametrize("channels", [(1, 1, 1, 1), (2, 1, 2, 1)])
def test_halves_that_contradict_each_other_are_merged_as_in_the_textbook(channels: tuple[int, ...]) -> None:
    merged = ambiguous = 0
    for seed in range(10, 13):
        rng = np.random.default_rng(seed)
        sensors = [
            Sensor(f"s{i}", C=rng.uniform(0.5, 2, (m, 1)), R=0.02 * np.eye(m) + 0.01)
            for i, m in enumerate(channels)
        ]
        plant, prior = Plant([[0.9]], [[1.0]], sensors), Belief([0.5], [[2.0]])
        says = rng.normal(scale=2, size=(25, 2))[:, [0, 0, 1, 1]][:, plant.channel_sensor]
        y = plant.C[:, 0] * says + rng.normal(scale=0.15, size=(25, plant.m))
        run = InnovationMixture(plant).run(y, prior=prior)
        assert prior.P is not None
        expected = book.innovation_mixture(plant, y, np.zeros((25, 0)), prior.x, prior.P)
        assert_equals_textbook(run, expected)
        merged += int((run.diagnostics["rival"] > 0).sum())
        ambiguous += int((run.status == Status.AMBIGUOUS).sum())
    assert merged >= 10 and ambiguous >= 5

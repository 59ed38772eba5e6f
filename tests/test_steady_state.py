"""The steady state of the filter: solved to the last digits, or refused with the reason."""

from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from securestate import DesignError, Plant, Sensor
from securestate._steady_state import steady_state

CASES = Path(__file__).parent / "cases" / "kalman"


def plant(A: object, Q: object, C: object, R: object = 1.0) -> Plant:
    rows = np.atleast_2d(np.asarray(C, dtype=float))
    sensors = [Sensor(f"s{i}", C=row) for i, row in enumerate(rows)]
    noise = np.asarray(R, dtype=float) * np.ones(len(rows))
    return Plant(A, Q, sensors, R=np.diag(noise))  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", range(60))
def test_p_repeats_itself_and_the_gain_stabilises(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, m = rng.integers(1, 12), rng.integers(1, 8)
    A = rng.normal(size=(n, n))
    A *= rng.uniform(0.1, 1.5) / np.abs(np.linalg.eigvals(A)).max()
    if seed % 3 == 1:
        A[:, 0] = 0.0  # singular
    root = rng.normal(size=(n, n)) * 10.0 ** rng.uniform(-3, 1)
    Q = np.zeros((n, n)) if seed % 3 == 2 else root @ root.T
    case = plant(A, Q, rng.normal(size=(m, n)), 10.0 ** rng.uniform(-4, 3, m))
    steady = steady_state(case)
    again = case.A @ steady.P_posterior @ case.A.T + case.Q
    std = np.sqrt(np.diag(steady.P_prior)) + np.abs(case.A) @ np.sqrt(np.diag(steady.P_prior))
    assert np.all(np.abs(again - steady.P_prior) <= 1e-11 * np.outer(std, std) + 1e-300)
    assert np.abs(np.linalg.eigvals(steady.M)).max() < 1
    np.testing.assert_allclose(
        steady.gain @ steady.innovation_cov, steady.P_prior @ case.C.T, rtol=1e-9, atol=1e-12
    )


def test_an_unstable_mode_without_noise_gets_the_stabilising_solution() -> None:
    steady = steady_state(plant([[2.0]], [[0.0]], [[1.0]]))
    np.testing.assert_allclose(steady.P_prior, 3.0)  # and not the solution P = 0
    np.testing.assert_allclose(steady.M, 0.5)


def test_the_building_is_solved_although_scipys_solution_misses_its_gain() -> None:
    with np.load(CASES / "building.npz") as data:
        case = Plant(data["A"], data["Q"], [Sensor("all", C=data["C"])], R=data["R"])
    steady = steady_state(case)
    scipys = solve_discrete_are(case.A.T, case.C.T, case.Q, case.R)
    P, gain = scipys, np.zeros((case.n, case.m))
    for _ in range(2000):
        gain = np.linalg.solve(case.C @ P @ case.C.T + case.R, case.C @ P).T
        F = np.eye(case.n) - gain @ case.C
        P = case.A @ (F @ P @ F.T + gain @ case.R @ gain.T) @ case.A.T + case.Q
    assert np.abs(steady.gain - gain).max() <= 1e-12 * np.abs(gain).max()
    first = np.linalg.solve(case.C @ scipys @ case.C.T + case.R, case.C @ scipys).T
    assert np.abs(first - gain).max() > 1e-6 * np.abs(gain).max()


@pytest.mark.parametrize(
    ("case", "reason"),
    [
        (plant(np.diag([1.0, 0.5]), np.eye(2), [[0.0, 1.0]]), r"no sensor sees mode 1 \(x1\).*add a sensor"),
        (
            plant(np.diag([1.0, 0.5]), np.diag([0.0, 1.0]), np.eye(2)),
            r"no process noise reaches mode 1 \(x1\)",
        ),
        (plant(np.full((5, 1, 1), 0.5), [[1.0]], [[1.0]]), "time-varying plant has no steady state"),
    ],
)
def test_a_plant_without_a_steady_state_is_refused_with_the_reason(case: Plant, reason: str) -> None:
    with pytest.raises(DesignError, match=reason):
        steady_state(case)

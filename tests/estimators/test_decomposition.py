"""The decomposition behind sparse fusion: the paper's identities, the golden numbers, the refusals."""

import json
import warnings
from pathlib import Path

import numpy as np
import pytest

from securestate import DesignError, InsecureWarning, Plant, Sensor, SparseFusion
from tests.estimators.sparse_cases import LIU_C, liu, stable_plant
from tests.reference import sparse_fusion as textbook

GOLDEN = json.loads((Path(__file__).parent.parent / "cases" / "sparse-fusion" / "liu2020.json").read_text())
with warnings.catch_warnings():
    warnings.simplefilter("ignore", InsecureWarning)
    FORMS = {"robust": SparseFusion(liu()), "paper": SparseFusion(liu(), form="paper", gamma=1.0)}


@pytest.mark.parametrize("form", FORMS)
def test_gain_covariance_and_eigenvalues_are_those_of_the_paper(form: str) -> None:
    steady = FORMS[form].decomposition.steady
    np.testing.assert_allclose(steady.gain, GOLDEN["K"], atol=1e-12)
    np.testing.assert_allclose(steady.P_posterior, GOLDEN["P"], atol=1e-12)
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(steady.M)), GOLDEN["eig"], atol=1e-12)
    assert round(float(np.trace(steady.P_posterior)), 5) == 0.83168


def test_paper_form_has_the_local_maps_of_the_paper() -> None:
    parts = FORMS["paper"].decomposition
    np.testing.assert_allclose(parts.G, GOLDEN["G"], atol=1e-12)
    np.testing.assert_allclose(parts.F, GOLDEN["F"], atol=1e-12)
    np.testing.assert_allclose(np.diag(parts.W), GOLDEN["diagW"], rtol=1e-11)
    np.testing.assert_allclose(np.diag(parts.N), GOLDEN["diagN_eig"], rtol=1e-10)


def test_paper_form_agrees_with_the_printed_formulas() -> None:
    parts, plant = FORMS["paper"].decomposition, liu()
    values = np.diag(parts.pair.T)
    G = textbook.local_maps_by_inverses(plant.A, plant.C, values)
    F = textbook.fusion_maps_by_eigenvectors(parts.steady.M, parts.steady.gain, values)
    np.testing.assert_allclose(parts.G, G, atol=1e-12)
    np.testing.assert_allclose(parts.F, F, atol=1e-12)


def test_robust_form_has_the_golden_orthonormal_pair() -> None:
    parts = FORMS["robust"].decomposition
    np.testing.assert_allclose(parts.pair.T, GOLDEN["TM"]["T"], atol=1e-12)
    np.testing.assert_allclose(parts.pair.b, GOLDEN["TM"]["b"], atol=1e-12)
    np.testing.assert_allclose(np.diag(parts.N), GOLDEN["TM"]["diagN"], atol=1e-12)
    np.testing.assert_allclose(np.linalg.cond(parts.W), GOLDEN["TM"]["condW"], rtol=1e-10)


@pytest.mark.parametrize("form", FORMS)
def test_local_estimates_sum_to_the_state(form: str) -> None:
    parts = FORMS[form].decomposition
    V_u = parts.split.V[:, : parts.split.flat]
    np.testing.assert_allclose(np.einsum("iab,ibc->ac", parts.F, parts.G), V_u, atol=1e-12)


def test_theorem_2_holds_in_the_paper_form() -> None:
    parts = FORMS["paper"].decomposition
    F, G = np.hstack(list(parts.F)), parts.G.reshape(15, 3)
    np.testing.assert_allclose(F @ parts.W, parts.steady.P_posterior @ G.T, atol=1e-12)


@pytest.mark.parametrize(("n", "m", "seed"), [(1, 3, 0), (2, 2, 1), (4, 6, 2), (5, 3, 3)])
def test_structured_covariance_equals_one_large_stein_equation(n: int, m: int, seed: int) -> None:
    plant = stable_plant(n, m, seed)
    parts = SparseFusion(plant).decomposition
    W = textbook.covariance_by_one_large_equation(
        plant.A, plant.C, plant.Q, plant.R, parts.pair.T, parts.pair.b, parts.split.V, parts.split.flat
    )
    np.testing.assert_allclose(parts.W, W, atol=1e-10 * np.abs(W).max())


def test_structured_covariance_is_right_with_flat_and_stable_modes_together() -> None:
    A = np.array([[1.0, 0.2, 0.0], [0.0, 0.7, 0.3], [0.0, 0.0, 1.05]])
    plant = Plant(A, np.eye(3), [Sensor(f"s{i}", C=row, R=1.0 + i) for i, row in enumerate(LIU_C)])
    parts = SparseFusion(plant).decomposition
    assert parts.split.flat == 2
    W = textbook.covariance_by_one_large_equation(
        A, plant.C, plant.Q, plant.R, parts.pair.T, parts.pair.b, parts.split.V, 2
    )
    np.testing.assert_allclose(parts.W, W, atol=1e-10 * np.abs(W).max())
    np.testing.assert_allclose(parts.N, textbook.information_left(W, parts.G.reshape(15, 2)), atol=1e-10)


@pytest.mark.parametrize("form", FORMS)
def test_information_in_factored_form_equals_the_dense_formula(form: str) -> None:
    parts = FORMS[form].decomposition
    N = textbook.information_left(parts.W, parts.G.reshape(15, 3))
    np.testing.assert_allclose(parts.N, N, atol=1e-9 * np.abs(N).max())


def test_a_double_integrator_on_two_axes_is_refused_by_the_paper_form_only() -> None:
    axis = np.array([[1.0, 1.0], [0.0, 1.0]])
    A, C = np.kron(np.eye(2), axis), np.kron(np.eye(2), [[1.0, 0.0]])
    Q = np.kron(np.eye(2), np.diag([0.1, 0.1]))
    sensors = [Sensor(f"axis {i}{j}", C=row, R=1.0) for i, row in enumerate(C) for j in range(3)]
    with pytest.raises(DesignError, match=r"derogatory.*robust"):
        SparseFusion(Plant(A, Q, sensors), form="paper", gamma=1.0)
    smallest = np.linalg.eigvalsh(SparseFusion(Plant(A, Q, sensors)).decomposition.W)[0]
    assert smallest >= 1 - 1e-12


def test_a_shared_eigenvalue_is_refused_by_the_paper_form_only() -> None:
    plant = Plant(
        [[0.0, 0.0], [0.0, 0.5]], np.eye(2), [Sensor("a", C=[[1, 1]], R=1), Sensor("b", C=[[0, 1]], R=1)]
    )
    with pytest.raises(DesignError, match=r"share the eigenvalue 0.*robust"):
        SparseFusion(plant, form="paper", gamma=1.0)
    assert SparseFusion(plant).decomposition.residual < 1e-12


def test_an_ill_conditioned_jordan_basis_is_refused() -> None:
    with pytest.raises(DesignError, match="condition number"):
        SparseFusion(stable_plant(10, 12, 5), form="paper", gamma=1.0)


def test_a_mode_that_nobody_sees_and_that_does_not_decay_is_refused_by_name() -> None:
    plant = Plant(
        np.diag([1.0, 0.5]), np.eye(2), [Sensor("a", C=[[0, 1]], R=1)], state_names=["tank", "pipe"]
    )
    with pytest.raises(DesignError, match="tank"):
        SparseFusion(plant)


def test_a_mode_on_the_unit_circle_without_noise_is_refused_by_name() -> None:
    plant = Plant(
        np.eye(2), np.diag([1.0, 0.0]), [Sensor("a", C=np.eye(2), R=1)], state_names=["tank", "pipe"]
    )
    with pytest.raises(DesignError, match="pipe"):
        SparseFusion(plant)


def test_a_plant_too_large_for_the_solver_is_refused_before_any_work() -> None:
    sensors = [Sensor(f"s{i}", C=np.eye(80)[i % 80], R=1.0) for i in range(100)]
    with pytest.raises(DesignError, match="8000 x 8000"):
        SparseFusion(Plant(0.5 * np.eye(80), np.eye(80), sensors))


def test_a_time_varying_plant_is_refused() -> None:
    plant = Plant(np.ones((5, 1, 1)), np.eye(1), [Sensor("a", C=[[1.0]], R=1.0)])
    with pytest.raises(DesignError, match="time-invariant"):
        SparseFusion(plant)


def random_plant(rng: np.random.Generator) -> Plant:
    """Any plant with n ≤ 12: stable or not, repeated eigenvalues, Jordan blocks, singular A, correlated R."""
    n, m = int(rng.integers(1, 13)), int(rng.integers(1, 9))
    A = rng.standard_normal((n, n))
    A *= rng.uniform(0.3, 1.3) / max(1e-9, float(np.abs(np.linalg.eigvals(A)).max()))
    kind = rng.integers(5)
    if kind == 1:
        V = np.linalg.qr(rng.standard_normal((n, n)))[0]
        A = V @ np.diag(rng.choice([0.5, 1.0, -0.7, 1.2], n)) @ V.T
    if kind == 2:
        V = rng.standard_normal((n, n))
        A = V @ (rng.choice([0.5, 1.0, 0.9, 0.0]) * np.eye(n) + np.eye(n, k=1)) @ np.linalg.inv(V)
    if kind == 3:
        A[:, rng.integers(n)] = 0
    C = rng.standard_normal((m, n))
    if kind == 4:
        C *= rng.random((m, n)) < 0.4
        C[:, 0] += np.abs(C).sum(axis=1) == 0
    G = rng.standard_normal((n, rng.integers(1, n + 1)))
    R = np.diag(10 ** rng.uniform(-2, 1, m))
    if rng.random() < 0.3:
        H = rng.standard_normal((m, m))
        R = H @ H.T + 0.1 * np.eye(m)
    owners = np.array_split(np.arange(m), m if rng.random() < 0.7 else max(1, m // 2))
    sensors = [Sensor(f"s{j}", C=C[rows]) for j, rows in enumerate(owners)]
    return Plant(A, G @ G.T * 10 ** rng.uniform(-4, 1), sensors, R=R)


@pytest.mark.filterwarnings("ignore::securestate.InsecureWarning")
@pytest.mark.parametrize("block", range(10))
def test_a_thousand_random_plants_run_with_w_above_r_or_are_refused_with_a_reason(block: int) -> None:
    rng = np.random.default_rng([2020, block])
    designed = 0
    for _ in range(100):
        plant = random_plant(rng)
        try:
            estimator = SparseFusion(plant)
        except DesignError as reason:
            assert len(str(reason)) > 20
            continue
        designed += 1
        W = estimator.decomposition.W
        rounding = 4 * len(W) * np.finfo(float).eps * np.linalg.norm(W, 2)
        assert np.linalg.eigvalsh(W)[0] >= np.linalg.eigvalsh(plant.R)[0] - rounding
        run = estimator.run(plant.denormalise(10 * rng.standard_normal((5, plant.m))))
        assert np.isfinite(run.x).all()
        assert np.nanmax(run.diagnostics["gap"]) <= 1e-9
    assert designed >= 80

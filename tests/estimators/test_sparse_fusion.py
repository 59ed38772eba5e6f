"""SparseFusion in use: Kalman when nobody lies, the oracle when somebody does, and never silent."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from securestate import (
    Belief,
    DesignError,
    InputError,
    KalmanFilter,
    MeasurementError,
    Plant,
    ResumeError,
    SecurestateWarning,
    Sensor,
    SparseFusion,
    Status,
)
from securestate._kernels import PenaltySolver
from tests.estimators.sparse_cases import liu, liu_record, record, stable_plant
from tests.reference.sparse_fusion import secure_fusion

Array = NDArray[np.float64]
GOLDEN = json.loads((Path(__file__).parent.parent / "cases" / "sparse-fusion" / "liu2020.json").read_text())
NEVER = 1e9  # a penalty that no honest or dishonest record reaches


def mse(estimate: Array, truth: Array, skip: int = 50) -> float:
    return float(((estimate - truth)[skip:] ** 2).sum(axis=1).mean())


@pytest.mark.parametrize("seed", range(3))
def test_the_decomposition_is_the_kalman_filter_over_20000_closed_loop_steps(seed: int) -> None:
    _, y, u = liu_record(20_000, seed)
    sum_of_locals = SparseFusion(liu(), gamma=NEVER).run(y, u)
    kalman = KalmanFilter(liu()).run(y, u)
    assert sum_of_locals.diagnostics["fast_path"].all()
    np.testing.assert_allclose(sum_of_locals.x, kalman.x, rtol=0, atol=1e-12 * np.abs(kalman.x).max())


@pytest.mark.parametrize(("n", "m"), [(2, 3), (5, 8), (10, 6), (20, 30)])
def test_the_decomposition_is_the_kalman_filter_at_any_size_with_inputs_and_a_prior(n: int, m: int) -> None:
    rng = np.random.default_rng(n)
    plant = stable_plant(n, m, n, B=rng.standard_normal((n, 2)), D=rng.standard_normal((m, 2)))
    y, u = rng.standard_normal((300, m)), rng.standard_normal((300, 2))
    prior = Belief(rng.standard_normal(n))
    ours = SparseFusion(plant, gamma=NEVER).run(y, u, prior)
    kalman = KalmanFilter(plant).run(y, u, prior)
    np.testing.assert_allclose(ours.x, kalman.x, rtol=0, atol=1e-11 * np.abs(kalman.x).max())
    np.testing.assert_allclose(ours.innovation, kalman.innovation, rtol=0, atol=1e-10 * np.abs(y).max())
    np.testing.assert_allclose(ours.innovation_std, kalman.innovation_std, rtol=1e-9)
    np.testing.assert_allclose(ours.P, kalman.P, atol=1e-9)


@pytest.mark.parametrize("probability", [0.9, 0.95, 0.99])
def test_the_fast_path_of_a_benign_run_is_as_frequent_as_asked(probability: float) -> None:
    _, y, u = liu_record(60_000, 5)
    run = SparseFusion(liu(), kalman_probability=probability).run(y, u, covariance=False)
    assert abs(run.diagnostics["fast_path"].mean() - probability) <= 0.01


@pytest.mark.parametrize(("n", "m"), [(2, 12), (6, 8), (12, 20)])
def test_the_kalman_probability_is_a_lower_bound_where_sensors_depend_on_each_other(n: int, m: int) -> None:
    plant = stable_plant(n, m, n)
    run = SparseFusion(plant, kalman_probability=0.8).run(record(plant, 20_000, 1)[1], covariance=False)
    assert 0.795 <= run.diagnostics["fast_path"].mean() <= 0.85


@pytest.mark.parametrize("liar", range(5))
def test_a_liar_costs_no_more_than_its_absence(liar: int) -> None:
    attack = 100.0 * np.eye(5)[liar]
    x, y, u = liu_record(30_000, 10 + liar, attack)
    run = SparseFusion(liu()).run(y, u, covariance=False)
    y_without = y.copy()
    y_without[:, liar] = np.nan
    oracle = mse(KalmanFilter(liu()).run(y_without, u).x, x)
    assert mse(run.x, x) <= 1.05 * oracle
    assert run.suspected[:, liar].mean() > 0.999
    assert np.delete(run.suspected, liar, axis=1).mean() < 0.01
    assert abs(np.median(run.attack[:, liar]) - 100) < 0.1
    assert run.trust[:, liar].max() < 0.01
    assert np.median(np.delete(run.trust, liar, axis=1)) > 0.99
    assert (run.status == Status.OK).all()


def test_the_kalman_filter_is_steered_by_the_same_liar() -> None:
    x, y, u = liu_record(2_000, 1, 100.0 * np.eye(5)[0])
    assert mse(KalmanFilter(liu()).run(y, u).x, x) > 50 * mse(SparseFusion(liu()).run(y, u).x, x)


@pytest.mark.parametrize("liar", [None, 0, 3])
def test_the_reported_covariance_is_honest(liar: int | None) -> None:
    attack = 0.0 if liar is None else 100.0 * np.eye(5)[liar]
    x, y, u = liu_record(30_000, 3, attack)
    run = SparseFusion(liu()).run(y, u)
    assert run.P is not None
    error = (run.x - x)[50:]
    nees = np.einsum("ki,kij,kj->k", error, np.linalg.inv(run.P[50:]), error).mean()
    assert 0.9 * 3 < nees < 1.1 * 3
    np.testing.assert_allclose(run.x_std**2, run.P.diagonal(axis1=1, axis2=2), rtol=1e-12)


def test_two_liars_among_nine_are_both_named_and_measured() -> None:
    rng = np.random.default_rng(4)
    plant = Plant(
        np.array([[0.95, 0.1], [0.0, 0.8]]),
        np.eye(2),
        [Sensor(f"s{i}", C=row, R=1.0) for i, row in enumerate(rng.standard_normal((9, 2)))],
    )
    x, y = record(plant, 3_000, 6)
    y[:, 2] += 12.0
    y[:, 7] -= 30.0
    run = SparseFusion(plant).run(y)
    assert set(np.flatnonzero(run.suspected.mean(axis=0) > 0.9)) == {2, 7}
    np.testing.assert_allclose(np.median(run.attack[:, [2, 7]], axis=0), [12, -30], atol=0.2)
    y[:, [2, 7]] = np.nan
    assert mse(run.x, x) <= 1.1 * mse(KalmanFilter(plant).run(y).x, x)


@pytest.mark.parametrize("scale", [0.0, 1.0, 30.0])
@pytest.mark.parametrize("seed", range(3))
def test_robust_form_solves_the_same_problem_as_a_general_solver(seed: int, scale: float) -> None:
    plant = stable_plant(4, 6, 20 + seed) if seed else liu(inputs=False)
    n, m = plant.n, plant.m
    rng = np.random.default_rng(seed)
    estimator = SparseFusion(plant, gamma=1.5, refit=False)
    parts = estimator.decomposition
    y = rng.standard_normal((6, m))
    y[:, 1] += scale
    run = estimator.run(y)
    G, F = parts.G.reshape(m * n, -1), parts.F.transpose(1, 0, 2).reshape(n, -1)
    blocks = [np.arange(i * n, (i + 1) * n) for i in range(m)]
    metrics = [np.linalg.cholesky(parts.N[np.ix_(b, b)]).T for b in blocks]
    zeta = np.zeros(m * n)
    for k in range(6):
        zeta = np.kron(np.eye(m), parts.pair.T) @ zeta + np.kron(y[k], parts.pair.b)
        f = secure_fusion(zeta, parts.W, G, blocks, [1.5] * m, metrics)
        np.testing.assert_allclose(run.x[k], F @ (zeta + f), rtol=0, atol=1e-6 * max(1.0, np.abs(zeta).max()))


@pytest.mark.filterwarnings("ignore::securestate.InsecureWarning")
@pytest.mark.parametrize("attack", [0.0, 20.0])
def test_paper_form_solves_problem_31(attack: float) -> None:
    plant = liu(inputs=False)
    estimator = SparseFusion(plant, form="paper", gamma=0.75)
    parts = estimator.decomposition
    y = np.random.default_rng(1).standard_normal((5, 5)) + attack * np.eye(5)[1]
    run = estimator.run(y)
    zeta = np.zeros(15)
    singles = [np.array([j]) for j in range(15)]
    for k in range(5):
        zeta = np.kron(np.eye(5), parts.pair.T) @ zeta + np.kron(y[k], parts.pair.b)
        f = secure_fusion(zeta, parts.W, parts.G.reshape(15, 3), singles, [0.75] * 15, [np.eye(1)] * 15)
        x = np.hstack(list(parts.F)) @ (zeta + f)
        np.testing.assert_allclose(run.x[k], x, rtol=0, atol=1e-6 * max(1.0, attack))


def test_a_complex_pair_in_real_form_is_the_complex_problem() -> None:
    """|f| + |conj f| of a pair is √2 times the 2-norm of its two real entries: the penalty of the paper."""
    c, s = 1.02 * np.cos(0.6), 1.02 * np.sin(0.6)
    A = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.2]])
    C = np.random.default_rng(0).standard_normal((6, 3))
    plant = Plant(A, np.diag([0.02, 0.02, 0.5]), [Sensor(f"s{i}", C=row, R=1.0) for i, row in enumerate(C)])
    estimator = SparseFusion(plant, form="paper", gamma=0.5)
    parts = estimator.decomposition
    assert [len(group) for group in parts.pair.groups] == [1, 2]
    groups = [i * 3 + group for i in range(6) for group in parts.pair.groups]
    gammas = [0.5 * np.sqrt(len(group)) for group in groups]
    y = np.random.default_rng(2).standard_normal((4, 6)) + 8 * np.eye(6)[0]
    run = estimator.run(y)
    zeta = np.zeros(18)
    for k in range(4):
        zeta = np.kron(np.eye(6), parts.pair.T) @ zeta + np.kron(y[k], parts.pair.b)
        metrics = [np.eye(len(group)) for group in groups]
        f = secure_fusion(zeta, parts.W, parts.G.reshape(18, 3), groups, gammas, metrics)
        np.testing.assert_allclose(run.x[k], np.hstack(list(parts.F)) @ (zeta + f), rtol=0, atol=1e-6)


@pytest.mark.filterwarnings("ignore::securestate.InsecureWarning")
@pytest.mark.parametrize("case", GOLDEN["lasso"], ids=lambda case: str(case["gamma"]))
def test_lasso_solutions_are_golden(case: dict[str, list[float]]) -> None:
    parts = SparseFusion(liu(), form="paper", gamma=1.0).decomposition
    zeta, N = np.array(case["zeta"]), parts.N
    solver = PenaltySolver(np.ascontiguousarray(N), list(range(16)), np.full(15, case["gamma"]))
    f, _, gap = solver.solve(-N @ zeta, float(zeta @ N @ zeta))
    assert gap <= 1e-9
    np.testing.assert_allclose(np.hstack(list(parts.F)) @ (zeta + f), case["x"], atol=1e-8)


@pytest.mark.parametrize("case", GOLDEN["group"], ids=lambda case: str(case["gamma"]))
def test_group_lasso_solutions_are_golden(case: dict[str, list[float]]) -> None:
    """One 2-norm per sensor: the solver wants diagonal blocks, so every block is rotated."""
    parts = SparseFusion(liu()).decomposition
    zeta, N = np.array(GOLDEN["lasso"][0]["zeta"]), parts.N
    S = np.zeros((15, 15))
    for i in range(5):
        s = slice(3 * i, 3 * i + 3)
        S[s, s] = np.linalg.eigh(N[s, s])[1]
    solver = PenaltySolver(
        np.ascontiguousarray(S.T @ N @ S), list(range(0, 16, 3)), np.full(5, case["gamma"])
    )
    g, _, gap = solver.solve(-S.T @ N @ zeta, float(zeta @ N @ zeta))
    assert gap <= 1e-9
    np.testing.assert_allclose(S @ g, case["f"], atol=1e-6)
    np.testing.assert_allclose(np.hstack(list(parts.F)) @ (zeta + S @ g), case["x"], atol=1e-6)


@pytest.mark.parametrize(
    ("n", "m", "steps"), [(1, 3, 50_000), (2, 4, 40_000), (3, 5, 10_000), (5, 9, 1_000), (8, 12, 200)]
)
def test_every_step_of_a_random_attack_ends_with_a_gap_below_1e_9(n: int, m: int, steps: int) -> None:
    plant = stable_plant(n, m, n)
    _, y = record(plant, steps, 0)
    rng = np.random.default_rng(9)
    y += rng.choice([0, 0, 0, 1, 10, 1000], (steps, m)) * rng.standard_normal((steps, m))
    for estimator in (SparseFusion(plant), SparseFusion(plant, gamma=0.3, refit=False)):
        run = estimator.run(y, covariance=False)
        assert run.diagnostics["gap"].max() <= 1e-9
        assert np.isfinite(run.x).all()
        assert not (run.status == Status.NOT_CONVERGED).any()


def test_a_sensor_that_is_always_missing_is_as_good_as_absent() -> None:
    x, y, u = liu_record(20_000, 2)
    y[:, 3] = np.nan
    with pytest.warns(SecurestateWarning, match="20% of the samples are missing"):
        run = SparseFusion(liu()).run(y, u, covariance=False)
    oracle = mse(KalmanFilter(liu()).run(y, u).x, x)
    assert mse(run.x, x) <= 1.05 * oracle
    assert np.isnan(run.trust[:, 3]).all() and np.isnan(run.attack[:, 3]).all()
    assert not run.suspected[:, 3].any()
    assert np.isfinite(np.delete(run.trust, 3, axis=1)).all()


def test_scattered_missing_channels_cost_little() -> None:
    x, y, u = liu_record(20_000, 2)
    y[np.random.default_rng(0).random(y.shape) < 0.05] = np.nan
    run = SparseFusion(liu()).run(y, u, covariance=False)
    assert mse(run.x, x) <= 1.15 * mse(KalmanFilter(liu()).run(y, u).x, x)
    assert run.suspected.mean() < 0.01


def test_without_any_measurement_the_estimate_is_a_prediction_with_its_covariance() -> None:
    plant = stable_plant(3, 5, 1)
    _, y = record(plant, 60, 3)
    y[20:25] = np.nan
    run = SparseFusion(plant, gamma=NEVER).run(y)
    assert run.P is not None
    assert (run.status[20:25] == Status.NO_MEASUREMENT).all()
    for k in range(20, 25):
        np.testing.assert_allclose(run.x[k], plant.A @ run.x[k - 1], atol=1e-12)
        np.testing.assert_allclose(run.P[k], plant.A @ run.P[k - 1] @ plant.A.T + plant.Q, atol=1e-9)
    assert (run.P[25].diagonal() > 1.0001 * run.P[19].diagonal()).any()
    np.testing.assert_allclose(run.P[-1], run.P[19], atol=1e-6)


@pytest.mark.parametrize("size", [1e6, 1e15, 1e100, 1e300])
def test_an_absurd_reading_is_survived(size: float) -> None:
    x, y, u = liu_record(400, 7)
    y[200, 1] = size
    run = SparseFusion(liu()).run(y, u)
    assert np.isfinite(run.x).all()
    assert run.suspected[200, 1]
    assert mse(run.x[260:], x[260:], 0) < 3 * 0.84
    assert mse(run.x[:200], x[:200]) < 3 * 0.84


def test_correlated_noise_and_vector_sensors_work_together() -> None:
    rng = np.random.default_rng(12)
    H = rng.standard_normal((8, 8))
    sensors = [Sensor(f"v{i}", C=rng.standard_normal((2, 3))) for i in range(4)]
    A = np.diag([0.9, 0.7, -0.5]) + 0.1 * np.eye(3, k=1)
    plant = Plant(A, np.eye(3), sensors, R=0.3 * H @ H.T + np.eye(8))
    x, y = record(plant, 5_000, 1)
    estimator = SparseFusion(plant)
    clean = estimator.run(y)
    kalman = KalmanFilter(plant).run(y)
    fast = clean.diagnostics["fast_path"] == 1
    assert fast.mean() > 0.9
    np.testing.assert_allclose(clean.x[fast], kalman.x[fast], atol=1e-11)
    y[:, 4:6] += [25.0, -40.0]
    run = estimator.run(y)
    assert run.suspected[:, 2].mean() > 0.99 and np.delete(run.suspected, 2, axis=1).mean() < 0.02
    np.testing.assert_allclose(np.median(run.attack[:, 4:6], axis=0), [25, -40], atol=1.0)
    assert mse(run.x, x) < 0.2 * mse(KalmanFilter(plant).run(y).x, x)


def test_file_units_change_the_numbers_and_nothing_else() -> None:
    rng = np.random.default_rng(3)
    C, B = rng.standard_normal((5, 2)), rng.standard_normal((2, 1))
    A = np.array([[0.9, 0.2], [0.0, 0.6]])
    offset, scale = np.array([100.0, 0, -5, 3, 20]), np.array([10.0, 0.1, 1, 2, 5])
    plain = Plant(A, np.eye(2), [Sensor(f"s{i}", C=row, R=1.0) for i, row in enumerate(C)], B=B)
    sensors = [Sensor(f"s{i}", C=row, R=1.0, offset=offset[i], scale=scale[i]) for i, row in enumerate(C)]
    units = Plant(A, np.eye(2), sensors, B=B, input_offset=7.0, input_scale=4.0)
    y, u = rng.standard_normal((200, 5)), rng.standard_normal((200, 1))
    y[100:, 2] += 20
    a = SparseFusion(plain).run(y, u)
    b = SparseFusion(units).run(offset + scale * y, 7 + 4 * u)
    np.testing.assert_allclose(a.x, b.x, atol=1e-9)
    np.testing.assert_allclose(a.attack * scale, b.attack, atol=1e-7)
    np.testing.assert_allclose(a.innovation * scale, b.innovation, atol=1e-8)
    np.testing.assert_array_equal(a.suspected, b.suspected)


def attacked_record() -> tuple[Plant, Array, Array]:
    _, y, u = liu_record(300, 4, 0.0)
    y[50:, 1] += 30.0
    y[np.random.default_rng(1).random(y.shape) < 0.03] = np.nan
    y[120:124] = np.nan
    return liu(), y, u


@pytest.mark.parametrize("at", [1, 49, 51, 122, 125, 250])
def test_a_saved_filter_continues_bit_for_bit(at: int) -> None:
    plant, y, u = attacked_record()
    estimator = SparseFusion(plant)
    whole = estimator.run(y, u)
    live = estimator.start()
    live.run(y[:at], u[:at])
    again = SparseFusion(plant).resume(live.save())
    rest = again.run(y[at:], u[at:])
    for name in ("x", "x_std", "P", "trust", "attack", "innovation", "status"):
        np.testing.assert_array_equal(getattr(rest, name), getattr(whole, name)[at:], err_msg=name)


def test_a_live_filter_gives_the_same_bits_as_a_run() -> None:
    plant, y, u = attacked_record()
    estimator = SparseFusion(plant)
    whole, live = estimator.run(y, u), estimator.start()
    for k in range(len(y)):
        e = live.step(y[k], u[k])
        for name in ("x", "x_std", "P", "trust", "attack", "suspected", "innovation", "innovation_std"):
            np.testing.assert_array_equal(getattr(e, name), getattr(whole, name)[k], err_msg=name)
        assert e.status == whole.status[k]
        assert e.diagnostics == {name: values[k] for name, values in whole.diagnostics.items()}


BATCH = """
import numpy as np, sys
from securestate import SparseFusion
from tests.estimators.sparse_cases import liu, liu_record
records = [liu_record(120, seed, 40.0 * np.eye(5)[seed % 5] * (seed > 2)) for seed in range(8)]
y, u = (np.stack([r[i] for r in records]) for i in (1, 2))
batch = SparseFusion(liu()).run(y, u)
loop = [SparseFusion(liu()).run(a, b) for a, b in zip(y, u)]
for name in ("x", "P", "trust", "attack", "innovation", "status"):
    np.testing.assert_array_equal(getattr(batch, name), np.stack([getattr(r, name) for r in loop]))
sys.stdout.buffer.write(batch.x.tobytes())
"""


def test_a_batch_equals_a_loop_bit_for_bit_whatever_the_number_of_threads() -> None:
    root = Path(__file__).parent.parent.parent

    def bits(threads: int) -> bytes:
        environment = os.environ | {"RAYON_NUM_THREADS": str(threads)}
        done = subprocess.run(
            [sys.executable, "-c", BATCH], env=environment, cwd=root, capture_output=True, check=True
        )
        return done.stdout

    assert bits(1) == bits(2) == bits(3)


def test_a_state_of_another_estimator_is_refused() -> None:
    blob = SparseFusion(liu()).start().save()
    with pytest.raises(ResumeError, match="another estimator"):
        SparseFusion(liu(), kalman_probability=0.9).resume(blob)
    with pytest.raises(ResumeError, match="damaged"):
        SparseFusion(liu()).resume(blob[:-1])


def test_a_prior_covariance_is_refused_because_the_filter_is_steady() -> None:
    with pytest.raises(InputError, match=r"prior\.P"):
        SparseFusion(liu()).start(Belief(np.zeros(3), np.eye(3)))


def test_an_infinite_measurement_is_an_error_that_says_where() -> None:
    y = np.zeros((5, 5))
    y[3, 2] = np.inf
    with pytest.raises(MeasurementError, match="channel 2 at sample 3"):
        SparseFusion(liu()).run(y, np.zeros((5, 3)))


@pytest.mark.parametrize(
    ("settings", "argument"),
    [
        ({"form": "other"}, "form"),
        ({"kalman_probability": 1.0}, "kalman_probability"),
        ({"kalman_probability": 0.9, "gamma": 1.0}, "gamma"),
        ({"form": "paper"}, "gamma"),
        ({"gamma": -1.0}, "gamma"),
        ({"gamma": float("nan")}, "gamma"),
        ({"gamma": [1.0, 2.0]}, "gamma"),
        ({"form": "paper", "gamma": [1.0] * 5}, "gamma"),
    ],
)
def test_a_bad_setting_is_named(settings: dict[str, object], argument: str) -> None:
    with pytest.raises(InputError) as caught:
        SparseFusion(liu(), **settings)
    assert caught.value.argument == argument


def test_one_sensor_alone_is_checked_by_the_prior_or_refused() -> None:
    plant = Plant([[0.9]], [[1.0]], [Sensor("only", C=[[1.0]], R=1.0)])
    run = SparseFusion(plant).run([[0.1], [50.0], [0.2]])
    assert np.isfinite(run.x).all()
    unstable = Plant([[1.2]], [[1.0]], [Sensor("only", C=[[1.0]], R=1.0)])
    with pytest.raises(DesignError, match=r"would not even show.*use KalmanFilter"):
        SparseFusion(unstable)
    protected = unstable.with_protected([0])
    run = SparseFusion(protected).run([[0.1], [50.0], [0.2]])
    np.testing.assert_allclose(run.x, KalmanFilter(unstable).run([[0.1], [50.0], [0.2]]).x, atol=1e-12)
    assert not run.suspected.any()

"""The cold start: states without a prior who lies, and a certificate that is never wrong."""

import json
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from scipy.stats import chi2

from securestate import (
    ColdStart,
    DesignError,
    InputError,
    MeasurementError,
    Plant,
    Sensor,
    ShapeError,
    cold_start,
)
from tests.estimators.kalman_cases import Array, random_data, random_plant
from tests.reference.cold_start import window_states

CASES = json.loads((Path(__file__).parents[1] / "cases/mixture/cold_start.json").read_text())["cold"]
#: What a certificate asks for beyond the conditions of the independent program, which certifies all three.
STRICTER = {"6_11_5_6_fixed_decoy": "no other sensor checks s3 and s7, whatever it says"}


def plant_of(A: Any, C: Any, q: float = 1e-4, r: float = 1e-4) -> Plant:
    sensors = [Sensor(f"s{i}", C=row, R=r) for i, row in enumerate(np.asarray(C))]
    return Plant(A, q * np.eye(len(np.asarray(A))), sensors)


@pytest.mark.parametrize("name", CASES)
def test_equals_an_independent_program(name: str) -> None:
    case = CASES[name]
    plant = plant_of(case["A"], case["C"], case["q"], case["r"])
    kind: Literal["fixed", "changing"] = "fixed" if case["fixed"] else "changing"
    first = cold_start(plant, case["Y"], attacked=kind, window=len(case["Y"]))
    np.testing.assert_array_equal(first.honest, np.array(case["honest"], dtype=bool))
    np.testing.assert_allclose(first.x[-1], case["x"], rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(np.diag(first.P[-1]), case["Pdiag"], rtol=1e-8)
    assert first.statistic == pytest.approx(case["stat"], rel=1e-8)
    assert first.degrees_of_freedom == case["dof"]
    assert (first.certified, first.reason) == (name not in STRICTER, STRICTER.get(name, ""))


class Problem:
    """A random plant and a record of 16 samples in which liars (16, N) add an injection (16, N)."""

    def __init__(
        self, n: int, N: int, liars: int, seed: int, *, kind: str = "noise", fixed: bool = True
    ) -> None:
        rng = np.random.default_rng([seed, n, N])
        A = rng.normal(size=(n, n)) * (rng.random((n, n)) < max(0.3, 2 / n))
        A /= max(float(np.abs(np.linalg.eigvals(A)).max()), 0.1)
        C = rng.normal(size=(N, n)) * (rng.random((N, n)) < max(0.3, 2 / n))
        C[~C.any(axis=1), 0] = 1.0
        self.plant, x, rows = plant_of(A, C), [10 * rng.normal(size=n)], 16
        for _ in range(rows):
            x.append(A @ x[-1] + 0.01 * rng.normal(size=n))
        self.x = np.array(x)
        chosen = rng.random((1 if fixed else rows, N)).argsort(axis=1) < liars
        self.liars = np.broadcast_to(chosen, (rows, N))
        self.honest_y = self.x[:-1] @ C.T + 0.01 * rng.normal(size=(rows, N))
        decoy = [20 / np.sqrt(n) * rng.normal(size=n)]
        for _ in range(rows - 1):
            decoy.append(A @ decoy[-1])
        added = {
            "noise": 20 * rng.normal(size=(rows, N)),
            "bias": np.broadcast_to(20 * np.sign(rng.normal(size=N)), (rows, N)),
            "decoy": np.array(decoy) @ C.T,
        }
        self.y = self.honest_y + self.liars * added[kind]

    def error(self, first: ColdStart) -> float:
        """Squared error of the belief over its covariance, chi-square with n degrees of freedom."""
        assert first.belief.P is not None
        error = first.belief.x - self.x[first.samples]
        return float(error @ np.linalg.solve(first.belief.P, error))


@pytest.mark.parametrize(("n", "N", "liars"), [(20, 20, 6), (50, 50, 15), (10, 31, 15)])
def test_fixed_liars_are_found_exactly(n: int, N: int, liars: int) -> None:
    for seed in range(10):
        one = Problem(n, N, liars, seed)
        first = cold_start(one.plant, one.y)
        assert first.certified and first.attacked == "fixed"
        np.testing.assert_array_equal(first.honest, ~one.liars[0])
        assert one.error(first) < chi2.isf(1e-6, n)


def test_changing_liars_are_found_and_only_lies_in_the_noise_are_missed() -> None:
    for seed in range(6):
        one = Problem(10, 20, 6, seed, fixed=False)
        first = cold_start(one.plant, one.y)
        lies = np.abs(one.y - one.honest_y)[: first.samples]
        assert first.certified and first.attacked == "changing"
        assert not (first.honest & (lies > 1)).any() and (~first.honest & (lies == 0)).sum() <= 1
        assert one.error(first) < chi2.isf(1e-6, 10)


def test_what_is_certified_is_right() -> None:
    certified = 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        n, N = int(rng.integers(1, 6)), int(rng.integers(3, 11))
        kind, fixed = ("noise", "bias", "decoy")[seed % 3], bool(rng.integers(2))
        one = Problem(n, N, int(rng.integers(0, (N - 1) // 2 + 1)), seed, kind=kind, fixed=fixed)
        try:
            first = cold_start(one.plant, one.y[:8])
        except DesignError as refusal:
            assert "no sensor sees mode" in refusal.reason
            continue
        assert np.isfinite(first.x).all() and np.isfinite(first.P).all()
        assert bool(first.reason) is not first.certified
        if first.certified:
            certified += 1
            assert one.error(first) < chi2.isf(1e-6, n), seed
    assert certified > 100


def test_liars_who_outvote_those_that_see_a_mode_are_not_certified() -> None:
    A, C = np.eye(2), [[1.0, 0]] * 3 + [[0, 1.0]] * 4  # three of seven see the first state, two of them lie
    rng = np.random.default_rng(0)
    y = np.array([[5.0, 5, 5, 2, 2, 2, 2]] * 8) + 0.01 * rng.normal(size=(8, 7))
    assert cold_start(plant_of(A, C), y).certified
    y[:, :2] += 30.0
    for attacked in ("any", "fixed", "changing"):
        first = cold_start(plant_of(A, C), y, attacked=attacked)
        assert first.reason == "another majority of the sensors agrees on another state"


def test_a_sensor_that_nobody_checks_is_not_certified_and_not_trusted() -> None:
    plant = plant_of(np.eye(2), [[1.0, 0], [1.0, 0], [1.0, 0], [0, 1.0]])
    first = cold_start(plant, np.full((8, 4), 3.0))
    assert first.reason == "no other sensor checks s3, whatever it says"
    assert np.isnan(first.trust[:, 3]).all() and (first.trust[:, :3] > 0.5).all()
    assert not first.suspected.any()


@pytest.mark.parametrize("varying", [False, True])
@pytest.mark.parametrize("missing", [0.0, 0.2])
def test_equals_least_squares_when_nobody_lies(missing: float, varying: bool) -> None:
    plant, T = general_plant(varying=varying), 8
    y, u, _ = honest_record(plant, T, 5)
    y[np.random.default_rng(1).random(y.shape) < missing] = np.nan
    first = cold_start(plant, y, u, window=T)
    assert first.certified and first.samples == T and not first.suspected.any()
    x, P = window_states(plant, y, u, np.ones(y.shape, dtype=bool))
    np.testing.assert_allclose(first.x, x, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(first.P, P, rtol=1e-7, atol=1e-9)
    A = plant.A[T - 1] if varying else plant.A
    ut = plant.normalise_input(u)
    np.testing.assert_allclose(first.belief.x, A @ x[-1] + plant.B @ ut[-1], rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(first.belief.P, A @ P[-1] @ A.T + plant.Q, rtol=1e-7, atol=1e-9)
    np.testing.assert_array_equal(np.isnan(first.attack), np.isnan(y))


def general_plant(*, varying: bool = False, guard: bool = False) -> Plant:
    """An unstable plant with vector sensors, inputs, units, and noise that sensors share."""
    rng = np.random.default_rng(7)
    A, n, m = np.array([[1.05, 0.2, 0.0], [0.0, 0.9, 0.3], [0.1, 0.0, 0.7]]), 3, 10
    noise = rng.normal(size=(m, 2 * m))
    C = rng.normal(size=(m, n))
    rows = [slice(0, 2), slice(2, 4), slice(4, 6), slice(6, 7), slice(7, 8), slice(8, 10)]
    time = np.linspace(1, 2, 30)[:, None, None] if varying else np.ones(())
    sensors = [
        Sensor(
            f"s{i}", C=time * C[own] if varying else C[own], protected=guard and i == 3,
            offset=10.0 * i, scale=0.5 + i, unit="bar",
        )
        for i, own in enumerate(rows)
    ]  # fmt: skip
    return Plant(
        np.broadcast_to(A, (30, n, n)) * (1 - 0.01 * np.arange(30)[:, None, None]) if varying else A,
        0.1 * np.eye(n),
        sensors,
        B=rng.normal(size=(n, 2)),
        D=rng.normal(size=(m, 2)),
        R=noise @ noise.T / m,
        input_offset=[1.0, -2.0],
        input_scale=[2.0, 0.1],
    )


def honest_record(plant: Plant, T: int, seed: int) -> tuple[Array, Array, Array]:
    """Readings (T, m) and inputs (T, p) in file units, and states (T + 1, n)."""
    rng = np.random.default_rng(seed)
    u = plant.input_offset + plant.input_scale * rng.normal(size=(T, plant.n_inputs))
    x = [100 * rng.normal(size=plant.n)]
    for k in range(T):
        w = rng.multivariate_normal(np.zeros(plant.n), plant.Q)
        x.append(plant.successor(x[-1][None], u[k : k + 1], k)[0] + w)
    clean = plant.reading(np.array(x[:-1]), u)
    v = rng.multivariate_normal(np.zeros(plant.m), plant.R, T)
    return clean + plant.scale * v, u, np.array(x)


@pytest.mark.parametrize("varying", [False, True])
def test_injections_into_a_vector_sensor_are_named_and_estimated_in_file_units(varying: bool) -> None:
    plant = general_plant(varying=varying)
    y, u, x = honest_record(plant, 10, 3)
    lie = np.zeros_like(y)
    lie[:, 2:4] = [300.0, -500.0]
    lie[:, 7] = 700.0
    y[1, 0] = y[2, 2] = np.nan
    first = cold_start(plant, y + lie, u, window=10)
    assert first.certified and first.honest.tolist() == [True, False, True, True, False, True]
    error = ((first.attack - lie) / first.attack_std)[~np.isnan(y) & (lie != 0)]
    assert error.size == 29 and np.abs(error).max() < 4
    assert (first.attack[(lie == 0) & ~np.isnan(y)] == 0).all() and np.isnan(first.attack[2, 2])
    believed = (lie == 0) & ~np.isnan(y)
    np.testing.assert_allclose(first.x, window_states(plant, y + lie, u, believed)[0], rtol=1e-7)
    assert np.abs(first.belief.x - x[10]).max() < 6 * np.sqrt(np.diag(first.belief.P)).max()


def test_covariances_and_test_statistic_are_what_they_claim() -> None:
    plant, errors, statistics = general_plant(), [], []
    for seed in range(200):
        y, u, x = honest_record(plant, 5, seed)
        first = cold_start(plant, y, u, attacked="fixed", window=5)
        assert first.belief.P is not None
        every = np.append(first.x, [first.belief.x], axis=0) - x
        P = np.append(first.P, [first.belief.P], axis=0)
        errors.append(np.einsum("ki,ki->k", every, np.linalg.solve(P, every[..., None])[..., 0]))
        statistics.append(first.statistic / first.degrees_of_freedom)
    low, high = chi2.ppf([1e-3, 1 - 1e-3], 3 * 200) / 200
    assert ((low < np.mean(errors, axis=0)) & (np.mean(errors, axis=0) < high)).all()
    assert np.mean(statistics) == pytest.approx(1, abs=4 * np.sqrt(2 / 47 / 200))


def test_protected_sensors_are_believed_against_any_majority() -> None:
    sensors = [Sensor(f"s{i}", C=[1.0], R=0.01, protected=i == 0) for i in range(5)]
    plant = Plant([[1.0]], [[1e-4]], sensors)
    y = np.full((8, 5), 4.0) + 0.1 * np.random.default_rng(0).normal(size=(8, 5))
    y[:, 1:4] += 9.0
    first = cold_start(plant, y)
    assert first.certified and first.honest.tolist() == [True, False, False, False, True]
    assert abs(first.x[-1, 0] - 4) < 0.2 and (first.trust[:, 0] == 1).all()
    plain = Plant([[1.0]], [[1e-4]], [Sensor(s.name, C=s.C, R=0.01) for s in sensors])
    assert cold_start(plain, y).honest.tolist() == [False, True, True, True, False]


def test_a_protected_sensor_that_contradicts_all_others_is_not_dropped() -> None:
    plant = general_plant(guard=True)
    y, u, _ = honest_record(plant, 6, 4)
    y[:, 6] += 1e4
    first = cold_start(plant, y, u)
    assert first.honest[..., 3].all() and not first.suspected[:, 3].any() and not first.certified


@pytest.mark.parametrize("size", [1e6, 1e12, 1e15, 1e30, 1e300])
def test_readings_of_any_size_are_distrusted_and_do_no_harm(size: float) -> None:
    one = Problem(6, 12, 0, 3)
    clean = cold_start(one.plant, one.y[:4], attacked="fixed")
    y = one.y[:4].copy()
    y[:, 2], y[:, 7] = size, -size
    first = cold_start(one.plant, y, attacked="fixed")
    assert first.certified and np.flatnonzero(~first.honest).tolist() == [2, 7]
    np.testing.assert_allclose(first.attack[:, [2, 7]], [[size, -size]] * 4, rtol=1e-4)
    assert np.isfinite(first.P).all() and np.abs(first.x - clean.x).max() < 0.1
    assert (first.trust[:, [2, 7]] < 1e-6).all()


def test_readings_that_are_all_too_large_are_not_certified() -> None:
    plant = plant_of([[1.0]], [[1.0]] * 3, r=1.0)
    first = cold_start(plant, np.full((6, 3), 1e20))
    assert not first.certified and np.isfinite(first.x).all() and np.isfinite(first.P).all()
    guarded = Plant([[1.0]], [[1.0]], [Sensor(f"s{i}", C=[1.0], R=1.0, protected=i == 0) for i in range(3)])
    y = np.ones((6, 3))
    y[:, 0] = 1e20
    first = cold_start(guarded, y)
    assert first.reason == "readings of s0, which cannot lie, are too large to be computed with"


def test_what_does_not_arrive_is_no_evidence() -> None:
    plant = general_plant()
    y, u, _ = honest_record(plant, 6, 2)
    y[:, 4:6] = np.nan
    first = cold_start(plant, y, u)
    assert first.certified and not first.honest[2] and not first.suspected.any()
    assert np.isnan(first.trust[:, 2]).all() and np.isnan(first.attack[:, 4:6]).all()
    for empty in (np.full_like(y, np.nan), np.where(np.arange(plant.m) == 0, y, np.nan)[:1]):
        first = cold_start(plant, empty, u[: len(empty)])
        assert first.reason == "the readings that arrived and can be believed do not determine the state"
        assert first.samples == len(empty) and first.degrees_of_freedom == 0
        assert np.isfinite(first.x).all() and np.isfinite(first.P).all()
        assert np.isnan(first.trust).all() and not first.suspected.any()


def test_the_window_grows_until_it_is_certified() -> None:
    plant = general_plant()
    y, u, _ = honest_record(plant, 16, 5)
    y[:, 2:4] += 1e4
    late = y.copy()
    late[:5] = np.nan
    first = cold_start(plant, late, u)
    assert first.certified and 5 < first.samples <= 16
    assert first.suspected[5:, 1].all() and first.suspected.sum() == first.samples - 5
    assert cold_start(plant, late[:5], u[:5]).samples == 5
    assert cold_start(plant, y, u, window=9).samples == 9


def test_directions_that_no_window_sees_are_refused_by_name() -> None:
    sensors = [Sensor(f"s{i}", C=[1.0, 0.0], R=1.0) for i in range(3)]
    plant = Plant(np.diag([0.9, 0.5]), np.eye(2), sensors, state_names=["level", "drift"])
    with pytest.raises(DesignError, match=r"no sensor sees mode 0\.5 \(drift\).*give a prior"):
        cold_start(plant, np.zeros((20, 3)))
    varying = Plant([np.diag([0.9, 0.5])] * 20, np.eye(2), sensors, state_names=["level", "drift"])
    with pytest.raises(DesignError, match="no sensor sees drift"):
        cold_start(varying, np.zeros((20, 3)))
    explosive = Plant(1e200 * np.eye(2), np.eye(2), [Sensor("a", C=np.eye(2), R=1.0)])
    with pytest.raises(DesignError, match="grows beyond all numbers"):
        cold_start(explosive, np.zeros((4, 2)))


def test_wrong_arguments_are_named() -> None:
    plant = random_plant(1)
    y, u = random_data(plant, 10, 1)
    bad: Any = "some"
    with pytest.raises(InputError, match="attacked: expected"):
        cold_start(plant, y, u, attacked=bad)
    with pytest.raises(InputError, match="window: expected at most 10"):
        cold_start(plant, y, u, window=11)
    with pytest.raises(InputError, match="plant: expected a Plant"):
        cold_start(bad, y, u)
    with pytest.raises(ShapeError, match="u: expected"):
        cold_start(plant, y)
    y[3, 2] = np.inf
    with pytest.raises(MeasurementError, match=r"y: expected finite numbers.*inf in channel 2"):
        cold_start(plant, y, u)
    with pytest.raises(MeasurementError, match="u: expected finite numbers, received nan in input 0"):
        cold_start(plant, np.zeros((1, 6)), [[np.nan, 0.0]])


def test_a_cold_start_is_a_value() -> None:
    one = Problem(3, 6, 1, 2)
    first = cold_start(one.plant, one.y)
    assert first == cold_start(one.plant, one.y) and first != cold_start(one.plant, one.honest_y)
    assert repr(first).endswith("certified)")
    with pytest.raises(AttributeError, match="immutable"):
        first.samples = 3

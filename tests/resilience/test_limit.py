"""The fundamental limit: against brute force, with bounds that never lie on the wrong side, in any units."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from benches.resilience import big_m, dc_grid
from securestate import DesignError, InputError, Plant, Sensor
from securestate.resilience import limit, profile, relevant
from securestate.resilience._bases import basis_along
from securestate.resilience._count import least_weight
from securestate.resilience._exact_count import Best, branch_and_bound
from securestate.resilience._hitting_set import hitting_set
from securestate.resilience.eigenspaces import Sight, eigenspaces, sight
from tests.estimators.sparse_cases import liu
from tests.reference.resilience import Case, count_of, fewest_seeing, random_case

ROOT = Path(__file__).parent.parent
GOLDEN = json.loads((ROOT / "cases" / "resilience" / "golden.json").read_text())
Array = NDArray[np.float64]
FOREVER = math.inf


def plant_of(case: Case, protected: tuple[int, ...] = ()) -> Plant:
    A, C, owner, _ = case
    sensors = [
        Sensor(f"s{i}", C=C[owner == i], R=0.5 + i, protected=i in protected)
        for i in range(int(owner.max()) + 1)
    ]
    return Plant(A, np.eye(len(A)), sensors)


def whole_space(rng: np.random.Generator, *, vectors: bool) -> tuple[Sight, int]:
    """What sensors see of a space of 3 to 6 dimensions, and how many see the direction that fewest see."""
    g, sensors = int(rng.integers(3, 7)), int(rng.integers(4, 11))
    owner = np.repeat(np.arange(sensors), rng.choice([1, 2], sensors) if vectors else 1)
    C = rng.integers(-1, 2, (len(owner), g)) * (rng.random((len(owner), g)) < 0.7)
    C = np.where(C.any(axis=1)[:, None], C, np.eye(g)[0]).astype(np.float64)
    seen = sight(eigenspaces(np.eye(g), C, 0.0)[0], C, owner, sensors)
    return seen, fewest_seeing(C, owner, sensors)


def test_limits_of_five_hundred_random_plants_are_those_of_brute_force() -> None:
    rng = np.random.default_rng(11)
    for k in range(500):
        case = random_case(rng, large_spaces=k % 3 == 0)
        for cut in (0.0, 0.95):
            found, count = limit(plant_of(case), cut), count_of(case, cut)
            assert found.lower == found.upper == count, (k, cut)
            free = int(case[2].max()) + 1
            expected = free if math.isinf(count) else min(free, max(-1, (int(count) - 1) // 2))
            assert found.max_attacked == found.max_attacked_upper == expected


def test_the_sensors_named_weakest_are_those_that_see_the_direction_named() -> None:
    rng = np.random.default_rng(12)
    for k in range(100):
        plant = plant_of(random_case(rng, large_spaces=k % 2 == 0))
        for mode in limit(plant, 0.0).modes:
            assert mode.mode is not None
            assert len(mode.sensors) == mode.upper
            v = mode.mode.direction
            seen = {plant.sensor_names[i] for i in range(plant.n_sensors) if _sees(plant, i, v)}
            assert seen == set(mode.sensors)
            np.testing.assert_allclose(plant.A @ v, mode.eigenvalue * v, atol=1e-6)


def _sees(plant: Plant, sensor: int, v: NDArray[np.complex128]) -> bool:
    return bool(np.abs(plant.C[plant.channels_of(sensor)] @ v).max() > 1e-6)


@pytest.mark.parametrize("vectors", [False, True])
def test_every_method_of_counting_alone_gives_the_count_of_brute_force(vectors: bool) -> None:
    rng = np.random.default_rng(13)
    checked = 0
    while checked < 30:
        seen, count = whole_space(rng, vectors=vectors)
        if not count:
            assert least_weight(seen).upper == 0
            continue
        checked += 1
        ones = np.ones(seen.sensors)
        best = Best(FOREVER)
        branch_and_bound(seen, ones, best, FOREVER)
        assert best.weight == count
        basis = basis_along(seen, np.arange(len(seen.rows)))
        assert basis is not None
        best = Best(FOREVER)
        assert hitting_set(seen, ones, [basis.sensors], best, 0.0, FOREVER) == best.weight == count
        found = least_weight(seen)
        assert found.lower == found.upper == count


def test_bounds_hold_when_there_is_no_time() -> None:
    rng = np.random.default_rng(14)
    open_bounds = 0
    for k in range(150):
        seen, count = whole_space(rng, vectors=k % 2 == 0)
        found = least_weight(seen, time_limit=0.0)
        assert found.lower <= count <= found.upper
        open_bounds += found.lower < found.upper
    assert open_bounds > 10


def test_bounds_hold_with_a_target_and_with_weights() -> None:
    rng = np.random.default_rng(15)
    for _ in range(80):
        seen, count = whole_space(rng, vectors=False)
        for target in (1, 2, 3):
            found = least_weight(seen, target=target)
            assert found.lower <= count <= found.upper
            assert found.lower >= target or found.upper < target or found.exact
        weights = rng.integers(0, 4, seen.sensors).astype(float)
        found = least_weight(seen, weights)
        assert found.lower == found.upper == _lightest(seen, weights)


def _lightest(seen: Sight, weights: Array) -> float:
    """Weight w of a sensor as w sensors of weight one."""
    rows = np.repeat(np.arange(len(seen.rows)), weights[seen.owner].astype(int))
    if np.linalg.matrix_rank(seen.rows[rows], tol=1e-6) < seen.dimension:
        return 0.0
    return fewest_seeing(seen.rows[rows], np.arange(len(rows)), len(rows))


def test_a_dense_case_that_cannot_be_closed_answers_with_both_bounds() -> None:
    rng = np.random.default_rng(16)
    C = rng.standard_normal((40, 12))
    plant = Plant(np.eye(12), np.eye(12), [Sensor(f"s{i}", C=row, R=1.0) for i, row in enumerate(C)])
    found = limit(plant, time_limit=2.0)
    assert 4 <= found.lower < found.upper == 29  # generic rows: any 11 can be blinded, no 12
    assert not found.exact
    assert found.max_attacked < found.max_attacked_upper == 14
    assert found.weakest is not None
    assert len(found.weakest.sensors) == 29


def test_two_hundred_simple_modes_and_sensors_are_counted() -> None:
    rng = np.random.default_rng(17)
    n = 200
    A = rng.standard_normal((n, n)) / np.sqrt(n)
    values, vectors = np.linalg.eig(A)
    C = rng.standard_normal((n, n))
    blind = int(np.argmax(np.abs(values)))
    hidden = np.linalg.qr(np.stack([vectors[:, blind].real, vectors[:, blind].imag], axis=1))[0]
    C[7:] -= C[7:] @ hidden @ hidden.T  # only the first seven sensors see the largest mode
    found = limit(Plant(A, np.eye(n), [Sensor(f"s{i}", C=row, R=1.0) for i, row in enumerate(C)]), 0.0)
    assert found.lower == found.upper == 7
    assert found.max_attacked == 3
    assert found.weakest is not None
    assert found.weakest.sensors == tuple(f"s{i}" for i in range(7))
    assert abs(abs(found.weakest.eigenvalue) - abs(values[blind])) < 1e-9


def test_units_of_states_and_channels_do_not_change_the_limit() -> None:
    rng = np.random.default_rng(18)
    for k in range(100):
        A, C, owner, bases = random_case(rng, large_spaces=k % 2 == 0)
        count = count_of((A, C, owner, bases), 0.0)
        units, gains = 10.0 ** rng.integers(-5, 6, len(A)), 10.0 ** rng.integers(-5, 6, len(C))
        scaled = Plant(
            A * units[:, None] / units,
            np.diag(units**2),
            [
                Sensor(f"s{i}", C=(C / units * gains[:, None])[owner == i], R=gains[owner == i] ** 2)
                for i in range(int(owner.max()) + 1)
            ],
        )
        found = limit(scaled, 0.0)
        assert found.lower == found.upper == count, k


def test_protected_sensors_count_without_limit() -> None:
    rng = np.random.default_rng(19)
    for k in range(100):
        case = random_case(rng, large_spaces=k % 2 == 0)
        _, C, owner, bases = case
        sensors = int(owner.max()) + 1
        safe = tuple(np.flatnonzero(rng.random(sensors) < 0.3).tolist())
        counts = []
        for V in bases.values():
            X = C @ np.linalg.qr(V)[0]
            guarded = X[np.isin(owner, safe)]
            _, sizes, Vh = np.linalg.svd(np.vstack([guarded, np.zeros((X.shape[1], X.shape[1]))]))
            left = Vh[sizes <= 1e-9].conj().T
            if left.shape[1]:
                counts.append(fewest_seeing(X @ left, owner, sensors))
        found = limit(plant_of(case, safe), 0.0)
        assert found.lower == found.upper == min(counts, default=math.inf), k
        assert found.max_attacked <= sensors - len(safe)


def test_a_jordan_block_is_one_mode_however_its_eigenvalues_scatter() -> None:
    rng = np.random.default_rng(20)
    for size in (2, 3, 4, 6):
        J = 1.0 * np.eye(size) + np.diag(np.ones(size - 1), 1)
        C = np.vstack([np.eye(size)[0], np.eye(size)[0], *np.eye(size)[1:], np.ones(size) - np.eye(size)[0]])
        T = np.linalg.qr(rng.standard_normal((size, size)))[0]
        sensors = [Sensor(f"s{i}", C=row @ T.T, R=1.0) for i, row in enumerate(C)]
        found = limit(Plant(T @ J @ T.T, np.eye(size), sensors))
        assert [mode.multiplicity for mode in found.modes] == [1]
        assert found.lower == found.upper == 2  # of the block only the first direction is an eigenvector


def test_eigenvalues_around_a_third_are_not_taken_for_it() -> None:
    for step in (1e-3, 1e-5, 1e-6):
        values = np.array([1 - step, 1.0, 1 + step])
        sensors = [Sensor(f"a{i}", C=np.eye(3)[0], R=1.0) for i in range(1)]
        sensors += [Sensor(f"b{i}", C=np.eye(3)[1], R=1.0) for i in range(5)]
        sensors += [Sensor(f"c{i}", C=np.eye(3)[2], R=1.0) for i in range(3)]
        found = limit(Plant(np.diag(values), np.eye(3), sensors), 0.0)
        assert sorted(mode.upper for mode in found.modes) == [1, 3, 5]


@pytest.mark.parametrize("distance", sorted(GOLDEN["cluster"]["counts"]))
def test_the_profile_tells_when_near_eigenvalues_count_as_one(distance: str) -> None:
    sensors = [Sensor(f"s{i}", C=row, R=1.0) for i, row in enumerate(GOLDEN["cluster"]["C"])]
    plant = Plant(np.diag([1.0, 1.0 + float(distance), 0.5]), np.eye(3), sensors)
    found = [[tol, one.lower, one.upper] for tol, one in profile(plant)]
    assert found == GOLDEN["cluster"]["counts"][distance]


def test_the_limit_and_the_margins_of_the_example_of_liu_are_golden() -> None:
    found = limit(liu())
    assert (found.lower, found.max_attacked) == (GOLDEN["liu"]["count"], GOLDEN["liu"]["p"])
    by_mode = {f"{mode.eigenvalue.real:.1f}": mode.upper for mode in found.modes}
    assert by_mode == GOLDEN["liu"]["per_mode"]
    for k in range(3):
        least = min(eta[k] for eta in GOLDEN["liu"]["eta"].values())
        np.testing.assert_allclose(found.margin(k + 1), (least, least), rtol=1e-9)
    assert found.margin(4) == (0.0, 0.0)
    assert found.margin(0) == (1.0, 1.0)


@pytest.mark.parametrize("case", ["case14", "case39", "case118", "case300"])
def test_the_limit_of_every_grid_is_golden(case: str) -> None:
    golden = GOLDEN["grids"][case]
    plant = dc_grid(case)
    found = limit(plant, 0.0)
    assert (plant.n, plant.m) == (golden["n"], golden["m"])
    assert (found.lower, found.upper, found.max_attacked) == (golden["lb"], golden["ub"], golden["p"])
    assert found.weakest is not None
    assert len(found.weakest.sensors) == 4
    rest = [i for i, name in enumerate(plant.sensor_names) if name not in found.weakest.sensors]
    assert np.linalg.matrix_rank(plant.C[rest]) == plant.n - 1
    known = np.delete(plant.C, golden["weak"], axis=0)
    assert np.linalg.matrix_rank(known) == plant.n - 1
    for k, (lower, upper, exact) in enumerate(golden.get("eta", []), 1):
        if exact and k < 4:
            np.testing.assert_allclose(found.margin(k), (lower, upper), rtol=1e-9)
    assert found.margin(4) == (0.0, 0.0)


def test_the_textbook_programme_finds_the_same_count_on_a_grid() -> None:
    assert big_m(dc_grid("case14").C) == limit(dc_grid("case14"), 0.0).lower == 4


def test_no_mode_of_the_grids_lasts_so_that_all_modes_count() -> None:
    plant = dc_grid("case14")
    assert limit(plant).modes == ()
    assert limit(plant).unlimited
    assert limit(plant).max_attacked == plant.n_sensors
    assert relevant(plant).cut == 0.0
    assert relevant(liu()).cut == 0.999


@pytest.mark.parametrize("case", range(40))
def test_two_lies_that_nobody_can_tell_apart_give_the_same_readings(case: int) -> None:
    rng = np.random.default_rng(100 + case)
    plant = plant_of(random_case(rng, large_spaces=case % 2 == 0))
    found = limit(plant, 0.0)
    attacked = found.max_attacked + 1
    lies = found.ambiguity(attacked)
    assert found.max_attacked < 0 or found.ambiguity(found.max_attacked) is None
    if found.max_attacked < 0 or lies is None:
        assert found.unlimited or found.upper == 0
        return
    first, second = lies
    assert not set(first.sensors) & set(second.sensors)
    assert max(len(first.sensors), len(second.sensors)) <= attacked
    steps = 12
    moved = first.shift(steps, 3.0)
    np.testing.assert_allclose(moved[1:], moved[:-1] @ plant.A.T, atol=1e-9 * np.abs(moved).max())
    honest = moved @ plant.C.T * plant.scale  # what the state d adds to every reading
    np.testing.assert_allclose(
        first.readings(steps, 3.0), honest - second.readings(steps, 3.0), atol=1e-6 * np.abs(honest).max()
    )
    seen = np.linalg.norm(moved @ (plant.C / np.sqrt(np.diag(plant.R))[:, None]).T, axis=1)
    at = -1 if min(abs(np.linalg.eigvals(first.J))) >= 0.9 else 0  # where the direction is stated
    np.testing.assert_allclose(seen[at], 3.0, rtol=1e-9)


def test_bad_arguments_are_refused_with_what_was_expected() -> None:
    plant = liu()
    varying = Plant(np.stack([np.eye(1)] * 3), [[1.0]], [Sensor("a", C=[1.0], R=1.0)])
    with pytest.raises(DesignError, match="constant A and C"):
        limit(varying)
    with pytest.raises(InputError, match=r"cut: expected a number >= 0, received -1"):
        limit(plant, -1)
    with pytest.raises(InputError, match=r"tol: expected a number in 0\.\.0\.1, received 2"):
        limit(plant, tol=2)
    with pytest.raises(InputError, match=r"removed: expected a whole number >= 0"):
        limit(plant).margin(-1)
    with pytest.raises(DesignError, match="overflow"):
        limit(Plant([[1e200]], [[1.0]], [Sensor("a", C=[1.0], R=1.0)]))


@pytest.mark.parametrize(
    "poles",
    [
        [1.0, 0.995, 0.985, 0.98],
        [1.0, 0.99, 0.98, 0.95],
        [1.003, 0.995, 0.985, 0.97],
        [1.0, 0.998, 0.996, 0.994, 0.992],
        [1.0, 0.98, 0.96, 0.95, 0.93, 0.92],
    ],
)
def test_a_lasting_mode_beside_slow_ones_is_never_lost(poles: list[float]) -> None:
    n = len(poles)
    A = np.diag(np.ones(n - 1), -1)  # a companion matrix: its eigenvectors are nearly parallel
    A[0] = -np.poly(poles)[1:]
    sensors = [Sensor("newest", C=np.eye(n)[0], R=1.0), Sensor("oldest", C=np.eye(n)[-1], R=1.0)]
    found = limit(Plant(A, np.eye(n), sensors))
    assert (found.lower, found.upper, found.max_attacked) == (2, 2, 0)


def test_what_tolerance_decides_is_never_claimed() -> None:
    rng = np.random.default_rng(21)
    for _ in range(60):
        g = int(rng.integers(2, 5))
        u = rng.standard_normal(g)
        u /= np.linalg.norm(u)
        C = rng.standard_normal((10, g))
        C[:5] -= np.outer(C[:5] @ u, u)  # five sensors are blind to u, but for errors of the model
        C += 3e-4 * rng.standard_normal(C.shape)
        found = limit(
            Plant(np.eye(g), np.eye(g), [Sensor(f"s{i}", C=c, R=1.0) for i, c in enumerate(C)]), tol=1e-3
        )
        shares = np.abs(C @ u) / np.linalg.norm(C, axis=1)
        assert found.lower <= np.sum(shares > 1e-3)

"""Which modes stay hidden, on plants where the answer is known on paper."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import ArrayLike, NDArray

from securestate import DesignError, InputError, Plant, Sensor
from securestate.resilience import (
    detectability_margin,
    undetectable_modes,
    unobserved_modes,
    unreachable_noise_modes,
)

CONSTANT_VELOCITY = np.kron(np.eye(2), [[1.0, 0.1], [0.0, 1.0]])  # states: px, vx, py, vy


def seen_by(A: ArrayLike, *rows: ArrayLike, Q: ArrayLike | None = None) -> Plant:
    """Return a plant with one sensor per row."""
    A = np.asarray(A, dtype=np.float64)
    noise = np.eye(A.shape[-1]) if Q is None else Q
    return Plant(A, noise, [Sensor(f"s{i}", C=row, R=1.0) for i, row in enumerate(rows)])


def orthogonal(n: int, seed: int) -> NDArray[np.float64]:
    return np.linalg.qr(np.random.default_rng(seed).normal(size=(n, n)))[0]


def rotated(A: ArrayLike, C: ArrayLike, seed: int) -> Plant:
    """Return the plant in other coordinates, so that no structure is left to see."""
    T = orthogonal(len(np.asarray(A)), seed)
    return seen_by(T @ A @ T.T, np.atleast_2d(C) @ T.T)


def test_an_integrator_that_nobody_measures_is_undetectable_and_named() -> None:
    (mode,) = undetectable_modes(seen_by([[1, 0], [0, 0.5]], [0, 1]))
    assert mode.eigenvalue == pytest.approx(1)
    assert mode.states == ("x1",)
    np.testing.assert_allclose(mode.direction, [1, 0], atol=1e-12)
    assert str(mode) == "mode 1 (x1)"


def test_a_position_cannot_be_told_from_its_velocity() -> None:
    (mode,) = undetectable_modes(seen_by([[1, 1], [0, 1]], [0, 1]))
    assert mode.states == ("x1",)
    assert undetectable_modes(seen_by([[1, 1], [0, 1]], [1, 0])) == ()


def test_each_axis_hidden_from_a_sensor_of_the_other_axis() -> None:
    plant = seen_by(CONSTANT_VELOCITY, [1, 0, 0, 0], [0, 0, 1, 0])
    assert undetectable_modes(plant) == ()
    assert [mode.states for mode in unobserved_modes(plant, 0)] == [("x3",)]
    assert [mode.states for mode in unobserved_modes(plant, 1)] == [("x1",)]


def test_two_hidden_integrators_give_two_modes_with_one_state_each() -> None:
    modes = undetectable_modes(seen_by(np.eye(3), [0, 1, 0]))
    assert sorted(mode.states for mode in modes) == [("x1",), ("x3",)]


def test_an_unstable_complex_pair_is_reported_once_with_both_its_states() -> None:
    A = np.zeros((3, 3))
    A[:2, :2] = [[0.9, -0.8], [0.8, 0.9]]
    A[2, 2] = 0.3
    (mode,) = undetectable_modes(seen_by(A, [0, 0, 1]))
    assert mode.eigenvalue == pytest.approx(0.9 + 0.8j)
    assert set(mode.states) == {"x1", "x2"}
    np.testing.assert_allclose(A @ mode.direction, mode.eigenvalue * mode.direction, atol=1e-12)
    assert str(mode).startswith("mode 0.9 ± 0.8i")


def test_a_hidden_mode_that_fades_is_fine_unless_the_cut_asks_for_it() -> None:
    plant = seen_by([[0.999, 0], [0, 0.5]], [0, 1])
    assert undetectable_modes(plant) == ()
    (mode,) = undetectable_modes(plant, cut=0.9)
    assert mode.eigenvalue == pytest.approx(0.999)


def test_cut_zero_finds_every_unobservable_mode() -> None:
    modes = undetectable_modes(seen_by(np.diag([0.0, 0.5, 0.7]), [0, 0, 1]), cut=0)
    assert sorted(mode.eigenvalue.real for mode in modes) == pytest.approx([0, 0.5])


@pytest.mark.parametrize("size", [2, 3, 4])
@pytest.mark.parametrize("seed", range(5))
def test_the_head_of_a_jordan_block_is_found_in_any_coordinates(size: int, seed: int) -> None:
    jordan = np.eye(size) + np.eye(size, k=1)
    second = np.eye(size)[1]  # sees all of the chain but its first vector
    assert len(undetectable_modes(rotated(jordan, second, seed))) == 1
    assert undetectable_modes(rotated(jordan, np.eye(size)[0], seed)) == ()


@pytest.mark.parametrize("size", [2, 3, 4, 5])
@pytest.mark.parametrize("seed", range(5))
def test_a_hidden_jordan_block_counts_once_however_its_eigenvalues_scatter(size: int, seed: int) -> None:
    A = np.zeros((size + 1, size + 1))
    A[:size, :size] = np.eye(size) + np.eye(size, k=1)
    (mode,) = undetectable_modes(rotated(A, np.eye(size + 1)[-1], seed))
    assert mode.eigenvalue == pytest.approx(1, abs=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_a_hidden_plane_of_one_eigenvalue_gives_two_directions(seed: int) -> None:
    modes = undetectable_modes(rotated(np.diag([1.0, 1.0, 1.0, 0.5]), np.eye(4)[2:], seed))
    assert [mode.eigenvalue for mode in modes] == pytest.approx([1, 1])
    assert np.linalg.matrix_rank(np.stack([mode.direction for mode in modes])) == 2


@given(st.integers(0, 10_000), st.integers(1, 4), st.integers(1, 4))
def test_a_hidden_unstable_subspace_is_found_in_any_coordinates(seed: int, seen: int, hidden: int) -> None:
    rng = np.random.default_rng(seed)
    n = seen + hidden
    A = np.zeros((n, n))
    A[:seen, :seen] = orthogonal(seen, seed) * 1.05
    A[seen:, seen:] = np.diag(1.2 + 0.1 * np.arange(hidden))
    C = np.hstack([rng.normal(size=(seen, seen)) + 3 * np.eye(seen), np.zeros((seen, hidden))])
    plant = rotated(A, C, seed + 1)
    modes = [mode for mode in undetectable_modes(plant) if abs(mode.eigenvalue) > 1.1]
    np.testing.assert_allclose(sorted(m.eigenvalue.real for m in modes), np.diag(A)[seen:], rtol=1e-9)
    for mode in modes:
        np.testing.assert_allclose(plant.C @ mode.direction, 0, atol=1e-7)


@given(st.lists(st.integers(-6, 6), min_size=4, max_size=4), st.integers(-6, 6))
def test_units_of_states_and_channels_do_not_change_the_verdict(powers: list[int], channel: int) -> None:
    unit = 10.0 ** np.array(powers)
    A = CONSTANT_VELOCITY * unit[:, None] / unit
    see_one = 10.0**channel * np.array([1.0, 0, 0, 0]) / unit
    see_two = np.array([0, 0, 1.0, 0]) / unit
    coupling = 0.1 * unit[[0, 2]] / unit[[1, 3]]
    if np.all(coupling > 1e-7):  # below that a coupling counts as rounding
        assert undetectable_modes(seen_by(A, see_one, see_two)) == ()
    assert len(undetectable_modes(seen_by(A, see_one))) >= 1


def test_a_mode_without_noise_is_named() -> None:
    plant = seen_by(np.diag([1.0, 0.9, 1.0]), [1, 1, 0], [0, 0, 1], Q=np.diag([0.0, 0.0, 1e-9]))
    (mode,) = unreachable_noise_modes(plant)
    assert (mode.eigenvalue, mode.states) == (pytest.approx(1), ("x1",))


def test_noise_that_arrives_through_the_dynamics_counts() -> None:
    assert unreachable_noise_modes(seen_by([[1, 1], [0, 1]], [1, 0], Q=np.diag([0.0, 1.0]))) == ()
    assert len(unreachable_noise_modes(seen_by([[1, 1], [0, 1]], [1, 0], Q=np.diag([1.0, 0.0])))) == 1
    assert len(unreachable_noise_modes(seen_by([[1, 1], [0, 1]], [1, 0], Q=np.zeros((2, 2))))) == 1


def test_noise_of_very_different_units_counts() -> None:
    assert unreachable_noise_modes(seen_by(np.eye(2), [1, 0], Q=np.diag([1e6, 1e-12]))) == ()


def test_a_direction_is_a_unit_vector_that_cannot_be_changed() -> None:
    (mode,) = undetectable_modes(seen_by([[1, 0], [0, 0.5]], [0, 1]))
    assert np.linalg.norm(mode.direction) == pytest.approx(1)
    with pytest.raises(ValueError, match="read-only"):
        mode.direction[0] = 2


@pytest.mark.parametrize("which", ["A", "C"])
def test_a_time_varying_plant_is_refused_naming_what_varies(which: str) -> None:
    A = np.ones((5, 1, 1)) if which == "A" else [[1.0]]
    C = np.ones((5, 1, 1)) if which == "C" else [[1.0]]
    plant = Plant(A, [[1.0]], [Sensor("s", C=C, R=1.0)])
    for find in (undetectable_modes, lambda p: unobserved_modes(p, 0), unreachable_noise_modes):
        with pytest.raises(DesignError, match=f"plant: {which} varies in time"):
            find(plant)


@pytest.mark.parametrize("cut", [-1.0, np.nan, np.inf, "1", True])
def test_a_cut_that_is_no_size_is_refused(cut: float) -> None:
    with pytest.raises(InputError, match="cut: expected"):
        undetectable_modes(seen_by([[1.0]], [1.0]), cut=cut)


def test_a_sensor_that_does_not_exist_is_refused() -> None:
    with pytest.raises(InputError, match=r"sensor: expected an index in 0\.\.0, received 1"):
        unobserved_modes(seen_by([[1.0]], [1.0]), 1)


def test_numbers_at_the_end_of_their_range_hide_nothing_and_raise_nothing() -> None:
    sensors = [Sensor("a", C=[1, 0], R=1.0), Sensor("b", C=[1, 1], R=1.0)]
    assert undetectable_modes(Plant([[1e308, 0.1], [0.0, 0.9]], np.eye(2), sensors)) == ()


def test_the_margin_of_detectability_is_zero_only_where_a_mode_is_hidden() -> None:
    plant = Plant(
        np.diag([1.0, 1.0 + 1e-3, 0.5]),
        np.eye(3),
        [Sensor("sum", C=[1, 1, 0], R=1.0), Sensor("first", C=[1, 0, 0], R=1.0)],
    )
    assert detectability_margin(plant, [1]) < 1e-12  # the second mode is hidden from the first sensor
    near = detectability_margin(plant, [0])
    assert 1e-4 < near < 1e-3  # two modes that only their eigenvalues tell apart
    assert detectability_margin(plant) > 0.3
    assert detectability_margin(plant, [1], cut=0.0) < 1e-12
    assert detectability_margin(Plant([[0.5]], [[1.0]], [Sensor("a", C=[1.0], R=1.0)])) == 1.0
    unit = 10.0 ** np.array([3, -4, 2])
    scaled = Plant(
        plant.A * unit[:, None] / unit, np.diag(unit**2), [Sensor("sum", C=plant.C[0] / unit, R=1.0)]
    )
    alone = detectability_margin(plant.select([0]))
    assert alone / 1.5 < detectability_margin(scaled) < 1.5 * alone  # the balance is in powers of two
    with pytest.raises(InputError, match="sensor"):
        detectability_margin(plant, [2])

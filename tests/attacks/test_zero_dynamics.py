"""A lie along a hidden mode: the Kalman filter's innovations stay as they are while its error grows."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

from securestate import Belief, DesignError, KalmanFilter, Plant, Sensor
from securestate.attacks import FakeState, ZeroDynamics
from tests.attacks.scenes import Float, injected, scene


def plant_of(A: ArrayLike, *rows: ArrayLike, **options: Any) -> Plant:
    """One sensor per row, in turn named a, b, c, ...; units differ."""
    sensors = [Sensor("abcdef"[i], C=row, R=0.5 + i, scale=1.0 + i, offset=i) for i, row in enumerate(rows)]
    n = len(np.asarray(A))
    return Plant(A, 0.1 * np.eye(n), sensors, **options)


def mixed(angle: float, seed: int = 0) -> tuple[Float, Float]:
    """A with an oscillating hidden pair and a stable mode, in coordinates that show no structure, and T."""
    pair = 1.1 * np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    A = np.zeros((3, 3))
    A[:2, :2], A[2, 2] = pair, 0.8
    T = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return T @ A @ T.T, T


def effect(plant: Plant, attack: ZeroDynamics, steps: int) -> tuple[Float, Float]:
    """Change of innovations in standard deviations, (T, m), and of the state estimate, (T,)."""
    runs, given = KalmanFilter(plant), scene(plant, steps, runs=1)
    # The readings of a plant at rest: differences of small numbers are then exact.
    clean = np.broadcast_to(plant.offset, given.y.shape)
    lied = clean + injected(attack, given)
    prior = Belief(np.zeros(plant.n))
    quiet, told = runs.run(clean, prior=prior), runs.run(lied, prior=prior)
    change = np.abs(told.innovation - quiet.innovation) / quiet.innovation_std
    return change[0], np.linalg.norm(told.x - quiet.x, axis=-1)[0]


def test_innovations_stay_while_the_error_grows_with_the_mode() -> None:
    plant = plant_of([[1.2, 0.0], [0.0, 0.9]], [1, 1], [0, 1], [0, 2])
    change, error = effect(plant, ZeroDynamics(on="a", start=10), steps=150)
    assert change.max() < 1e-9
    assert error[-1] > 1e-1
    np.testing.assert_allclose(error[60:] / error[59:-1], 1.2, rtol=1e-3)


def test_an_oscillating_mode_in_any_coordinates() -> None:
    A, T = mixed(0.7)
    rows = np.array([[1.0, 0.3, 0.2], [0.0, 0.0, 1.0], [0.0, 0.0, 2.0]]) @ T.T
    plant = plant_of(A, *rows)
    change, error = effect(plant, ZeroDynamics(on="a", start=5), steps=200)
    assert change.max() < 1e-9
    assert np.log(error[-1] / error[60]) / 139 == pytest.approx(np.log(1.1), rel=0.05)


def test_all_sensors_lying_can_tell_any_growing_mode() -> None:
    plant = plant_of([[1.2, 0.0], [0.0, 0.9]], [1, 1], [0, 1])
    a = injected(ZeroDynamics(on=["a", "b"], size=1e-3, start=2), scene(plant, steps=20))
    np.testing.assert_allclose(a[0, 2:, 0], 1e-3 * 1.2 ** np.arange(18), rtol=1e-12)
    np.testing.assert_allclose(a[:, :, 1], 0.0, atol=1e-15)


def test_the_lie_obeys_the_plant_to_rounding_however_large_it_is() -> None:
    A, T = mixed(0.7)
    rows = np.eye(3) @ T.T
    plant = plant_of(A, *rows)
    a = injected(ZeroDynamics(on=["a", "b"], size=1.0), scene(plant, steps=300, runs=1))[0]
    d = np.linalg.solve(rows[:3], (a / plant.scale).T).T
    step = np.linalg.norm(d[1:] - d[:-1] @ plant.A.T, axis=1) / np.linalg.norm(d[1:], axis=1)
    assert step.max() < 1e-13


def test_a_lie_that_has_grown_beyond_1e100_is_held() -> None:
    plant = plant_of([[10.0, 0.0], [0.0, 0.9]], [1, 0], [0, 1])
    a = injected(ZeroDynamics(on="a", size=1.0), scene(plant, steps=30, runs=1))
    long = scene(plant, steps=30, runs=1)
    given = type(long)(plant, *(np.zeros((1, 500, k)) for k in (2, 0, 2, 2)), long.rngs)
    held = injected(ZeroDynamics(on="a", size=1.0), given)[0, :, 0]
    np.testing.assert_allclose(held[:30], a[0, :, 0])
    assert np.all(np.isfinite(held))
    assert held.max() == pytest.approx(1e100, rel=1e-9)


def test_a_marginal_mode_does_no_harm_by_itself_and_a_ramp_does() -> None:
    plant = plant_of([[1.0, 0.0], [0.0, 0.9]], [1, 1], [0, 1], [0, 2])
    change, error = effect(plant, ZeroDynamics(on="a", start=10), steps=150)
    assert change.max() < 1e-9
    assert error.max() < 1e-8
    given = scene(plant, steps=10000, runs=1)
    assert injected(FakeState([1e-3, 0.0], "ramp", on="a"), given)[0, -1, 0] > 9.9


def test_the_largest_hidden_mode_that_an_attacked_sensor_sees_is_taken() -> None:
    plant = plant_of(np.diag([1.3, 1.2, 1.1, 0.5]), [0, 1, 1, 0], [1, 0, 0, 1])
    a = injected(ZeroDynamics(on="a", size=1.0), scene(plant, steps=5))
    np.testing.assert_allclose(a[0, :, 0], 1.2 ** np.arange(5))


def test_honest_sensors_that_see_every_mode_leave_nothing_to_hide_in() -> None:
    plant = plant_of([[1.2, 0.0], [0.0, 0.9]], [1, 1], [1, 0], [0, 2])
    with pytest.raises(DesignError, match=r"the sensors left alone \(b, c\) see every mode .* WorstCase"):
        injected(ZeroDynamics(on="a"), scene(plant))


def test_a_mode_that_nobody_sees_needs_no_lie() -> None:
    plant = plant_of([[1.2, 0.0], [0.0, 0.9]], [0, 1], [0, 2])
    with pytest.raises(DesignError, match=r"no sensor sees mode 1.2 \(x1\), so that no lie is needed"):
        injected(ZeroDynamics(on="a"), scene(plant))


def test_the_default_size_needs_a_steady_state() -> None:
    plant = plant_of([[1.0, 0.0], [0.0, 0.9]], [1, 0], [0, 1])
    still = Plant(plant.A, np.diag([0.0, 1.0]), plant.sensors)
    with pytest.raises(DesignError, match=r"the default size needs a steady state: .* give a size"):
        injected(ZeroDynamics(on="a"), scene(still))
    assert np.any(injected(ZeroDynamics(on="a", size=1.0), scene(still)))

"""Local filters: each sensor's own Kalman filter on what it sees."""

import numpy as np
import pytest

from securestate import DesignError, KalmanFilter, Plant, Sensor
from securestate._local_filters import local_filters, observable_basis


def vehicle() -> Plant:
    axis = np.array([[1.0, 0.5], [0.0, 0.95]])
    sensors = [
        Sensor("x", C=[1, 0, 0, 0], R=1.0),
        Sensor("y", C=[0, 0, 2, 0], R=2.0),
        Sensor("vy", C=[0, 0, 0, 1], R=0.5),
    ]
    return Plant(np.kron(np.eye(2), axis), np.diag([0.1, 0.2, 0.1, 0.2]), sensors)


def test_a_sensor_follows_only_the_modes_that_it_sees() -> None:
    sizes = [len(each.A) for each in local_filters(vehicle())]
    assert sizes == [2, 2, 1]


def test_a_local_filter_predicts_as_the_kalman_filter_of_that_sensor_alone() -> None:
    plant = vehicle()
    y = np.random.default_rng(3).standard_normal((200, 2)).cumsum(axis=0)
    own = local_filters(plant)[1]
    z, innovations = np.zeros(len(own.A)), []
    for value in y[:, 1]:
        innovations.append(value - own.C @ z)
        z = own.A @ (z + own.gain @ innovations[-1])
    axis = Plant(plant.A[2:, 2:], plant.Q[2:, 2:], [Sensor("y", C=[2, 0], R=2.0)])
    run = KalmanFilter(axis).run(y[:, 1:])
    np.testing.assert_allclose(np.array(innovations), run.innovation, rtol=0, atol=1e-10)
    np.testing.assert_allclose(np.sqrt(own.innovation_cov[0, 0]), run.innovation_std[-1, 0], rtol=1e-10)


def test_the_basis_spans_the_observable_space_of_any_plant() -> None:
    rng = np.random.default_rng(5)
    for _ in range(50):
        n, seen = 6, int(rng.integers(1, 7))
        blocks = np.zeros((n, n))
        blocks[:seen, :seen] = rng.standard_normal((seen, seen))
        blocks[seen:] = rng.standard_normal((n - seen, n))
        turn = np.linalg.qr(rng.standard_normal((n, n)))[0]
        A, C = turn @ blocks @ turn.T, np.append(rng.standard_normal(seen), np.zeros(n - seen)) @ turn.T
        T = observable_basis(A, C[np.newaxis])
        assert T.shape == (seen, n)
        np.testing.assert_allclose(T @ T.T, np.eye(seen), atol=1e-12)
        np.testing.assert_allclose(T @ A @ T.T @ T, T @ A, atol=1e-7)


def test_a_sensor_without_a_filter_of_its_own_is_named() -> None:
    plant = Plant(
        np.diag([1.0, 0.5]), np.diag([0.0, 1.0]), [Sensor("a", C=[1, 0], R=1), Sensor("b", C=[0, 1], R=1)]
    )
    with pytest.raises(
        DesignError, match="sensor 'a' has no steady-state filter of its own: no process noise"
    ):
        local_filters(plant)

"""The least that honest sensors see of a lie, against brute force over directions."""

from itertools import combinations

import numpy as np
import pytest
from numpy.typing import NDArray

from securestate import DesignError, InputError, Plant, Sensor
from securestate.resilience import margin, modes

Complex = NDArray[np.complex128]


def random_plant(seed: int, values: list[float], *, n_sensors: int = 5) -> Plant:
    """A plant with these real eigenvalues, some sensors with two channels, in random coordinates."""
    rng = np.random.default_rng(seed)
    n = len(values)
    T = np.linalg.qr(rng.normal(size=(n, n)))[0]
    sensors = []
    for i in range(n_sensors):
        root = rng.normal(size=(1 + i % 2, 1 + i % 2))
        noise = root @ root.T + 0.3 * np.eye(len(root))
        sensors.append(Sensor(f"s{i}", C=rng.normal(size=(len(root), n)), R=noise))
    return Plant(T @ np.diag(values) @ T.T, np.eye(n), sensors)


def shares(plant: Plant, attacked: tuple[int, ...], V: Complex) -> NDArray[np.float64]:
    """||X_honest v|| / ||X v|| for every column of V, sensor by sensor from the definition."""
    honest, everyone = np.zeros(V.shape[1]), np.zeros(V.shape[1])
    for i in range(plant.n_sensors):
        rows = plant.channels_of(i)
        shown = plant.C[rows] @ V
        seen = np.real(np.sum(shown.conj() * np.linalg.solve(plant.R[rows, rows], shown), axis=0))
        everyone += seen
        honest += seen * (i not in attacked)
    return np.sqrt(honest / everyone)


@pytest.mark.parametrize("values", [[1.0, 0.5, 0.3], [1.0, 1.0, 0.5], [1.0, 1.0, 1.0], [1.2, 1.0, 1.0]])
def test_eta_is_the_smallest_share_over_all_directions(values: list[float]) -> None:
    rng = np.random.default_rng(3)
    for seed in range(5):
        plant = random_plant(seed, values)
        for attacked in combinations(range(5), 2):
            found = margin(plant, attacked)
            own = shares(plant, attacked, found.mode.direction[:, np.newaxis])[0]
            assert found.eta == pytest.approx(own, abs=1e-9)
            spaces = [[m for m in modes(plant) if abs(m.eigenvalue - value) < 1e-6] for value in set(values)]
            for space in filter(None, spaces):
                basis = np.stack([m.direction for m in space], axis=1)
                tried = basis @ rng.normal(size=(len(space), 20000))
                smallest = shares(plant, attacked, tried).min()
                assert found.eta <= smallest + 1e-9
                if abs(space[0].eigenvalue - found.mode.eigenvalue) < 1e-6:
                    assert smallest < found.eta + 0.05


def test_a_complex_mode_has_complex_directions() -> None:
    A = 1.05 * np.array([[0.6, 0.8], [-0.8, 0.6]])
    sensors = [Sensor("a", C=[1, 2], R=1.0), Sensor("b", C=[3, -1], R=4.0), Sensor("c", C=[0.2, 1], R=0.5)]
    plant = Plant(A, np.eye(2), sensors)
    found = margin(plant, [1])
    v = np.array([[1.0], [1.0j]])
    assert found.eta == pytest.approx(shares(plant, (1,), v)[0])
    assert found.mode.eigenvalue == pytest.approx(1.05 * (0.6 + 0.8j))


def test_eta_is_exactly_0_if_and_only_if_a_mode_is_hidden() -> None:
    for seed in range(20):
        T = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
        rows = np.array([[1.0, 1.0, 0.0], [0.0, 1.0, 2.0], [0.0, 3.0, 1.0], [1e-5, 0.0, 1.0]]) @ T.T
        sensors = [Sensor(f"s{i}", C=row, R=1.0 + i) for i, row in enumerate(rows)]
        plant = Plant(T @ np.diag([1.0, 0.5, 0.2]) @ T.T, np.eye(3), sensors)
        assert margin(plant, [0, 3]).eta == 0.0
        assert margin(plant, [0]).eta == pytest.approx(0.5e-5, rel=1e-6)


def test_nobody_attacked_gives_1_and_everybody_0() -> None:
    plant = random_plant(1, [1.0, 0.5])
    assert margin(plant, []).eta == pytest.approx(1.0)
    assert margin(plant, range(5)).eta == 0.0


def test_seen_is_what_all_sensors_see_of_the_unit_direction() -> None:
    plant = Plant([[1.0]], [[1.0]], [Sensor("a", C=[3.0], R=4.0), Sensor("b", C=[2.0], R=1.0)])
    assert margin(plant, [0]).seen == pytest.approx(2.5)


def test_only_modes_above_the_cut_count_and_all_if_there_is_none() -> None:
    sensors = [Sensor("a", C=[1, 0], R=1.0), Sensor("b", C=[1, 1], R=1.0), Sensor("c", C=[0, 0.1], R=1.0)]
    plant = Plant(np.diag([1.0, 0.9]), np.eye(2), sensors)
    assert margin(plant, [1]).eta == pytest.approx(np.sqrt(1 / 2))
    assert margin(plant, [1], cut=0.8).mode.eigenvalue == pytest.approx(0.9)
    fading = Plant(np.diag([0.8, 0.9]), np.eye(2), sensors)
    assert margin(fading, [1]).eta == margin(fading, [1], cut=0.0).eta


def test_modes_that_nobody_sees_do_not_count() -> None:
    sensors = [Sensor("a", C=[0, 1], R=1.0), Sensor("b", C=[0, 1], R=1.0)]
    plant = Plant(np.diag([1.2, 1.0]), np.eye(2), sensors)
    assert margin(plant, [0]).mode.eigenvalue == pytest.approx(1.0)
    with pytest.raises(DesignError, match="no sensor sees any mode that counts"):
        margin(plant, [0], cut=1.1)


def test_liu_2020_has_the_margins_of_one_lying_sensor_that_its_modes_have() -> None:
    rows = [[1, 0, 0], [1, 1, -1], [1, 2, 1], [1, -1, -0.5], [-0.5, 1, 1]]
    sensors = [Sensor(f"s{i}", C=row, R=1.0) for i, row in enumerate(rows)]
    plant = Plant(np.diag([1.0, 1.0, -2.0]), np.eye(3), sensors)
    worst = min(margin(plant, [i]).eta for i in range(5))
    assert worst == pytest.approx(0.588, abs=5e-4)
    steep = min(margin(plant, [i], cut=1.5).eta for i in range(5))
    assert steep == pytest.approx(0.832, abs=5e-4)


def test_a_sensor_that_does_not_exist_is_refused() -> None:
    with pytest.raises(InputError, match=r"attacked: expected indices in 0..4, received 5"):
        margin(random_plant(0, [1.0]), [5])

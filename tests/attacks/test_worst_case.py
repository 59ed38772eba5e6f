"""The lie that the honest sensors see least."""

import numpy as np
import pytest

from securestate import DesignError, Plant, Sensor
from securestate.attacks import WorstCase
from securestate.resilience import margin
from tests.attacks.scenes import Float, injected, scene


def told(plant: Plant, attack: WorstCase, steps: int = 40) -> Float:
    """The lie of all sensors, as far as the attacked ones tell it, in standard deviations of the noise."""
    a = injected(attack, scene(plant, steps, runs=1))[0]
    return a / (plant.scale * np.sqrt(np.diag(plant.R)))


def test_its_size_is_what_all_sensors_together_would_see() -> None:
    sensors = [
        Sensor("a", C=[2.0], R=4.0, scale=5.0),
        Sensor("b", C=[3.0], R=1.0),
        Sensor("c", C=[0.5], R=0.25),
    ]
    plant = Plant([[1.0]], [[1.0]], sensors)
    a = told(plant, WorstCase(10.0, on=["a", "b"], start=4))
    seen = np.array([1.0, 3.0, 1.0])
    np.testing.assert_allclose(a[4:], np.broadcast_to(10 * seen / np.sqrt(11) * [1, 1, 0], (36, 3)))
    assert margin(plant, [0, 1]).eta == pytest.approx(1 / np.sqrt(11))


def test_it_moves_with_a_growing_mode_and_holds_a_fading_one() -> None:
    growing = Plant([[1.1]], [[1.0]], [Sensor("a", C=[1.0], R=1.0), Sensor("b", C=[1.0], R=1.0)])
    np.testing.assert_allclose(
        told(growing, WorstCase(2.0, on="a"))[:, 0], np.sqrt(2) * 1.1 ** np.arange(40), rtol=1e-12
    )
    fading = Plant([[0.6]], [[1.0]], growing.sensors)
    np.testing.assert_allclose(told(fading, WorstCase(2.0, on="a"))[:, 0], np.sqrt(2))
    flipping = Plant([[-0.6]], [[1.0]], growing.sensors)
    np.testing.assert_allclose(
        told(flipping, WorstCase(2.0, on="a"))[:, 0], np.sqrt(2) * (-1.0) ** np.arange(40)
    )
    gone = Plant([[0.0]], [[1.0]], growing.sensors)
    np.testing.assert_allclose(told(gone, WorstCase(2.0, on="a"))[:, 0], np.sqrt(2))


def test_an_oscillating_lie_has_its_size_on_average_over_a_turn() -> None:
    turn = 2 * np.pi / 8
    A = [[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]
    plant = Plant(A, np.eye(2), [Sensor("a", C=[1, 0.5], R=1.0), Sensor("b", C=[0, 1], R=2.0)])
    a = told(plant, WorstCase(3.0, on=["a", "b"]), steps=16)
    assert np.mean(np.sum(a**2, axis=1)) == pytest.approx(9.0)


def test_it_hides_completely_where_the_honest_sensors_are_blind() -> None:
    sensors = [Sensor("a", C=[1, 1], R=1.0), Sensor("b", C=[0, 1], R=1.0), Sensor("c", C=[0, 1], R=1.0)]
    plant = Plant(np.diag([1.0, 0.5]), np.eye(2), sensors)
    a = told(plant, WorstCase(4.0, on=["a", "b"]))
    np.testing.assert_allclose(a, np.broadcast_to([4.0, 0.0, 0.0], (40, 3)), atol=1e-12)


def test_a_plant_that_varies_is_refused() -> None:
    plant = Plant(np.full((50, 1, 1), 0.9), [[1.0]], [Sensor("a", C=[1.0], R=1.0)])
    clean = scene(Plant([[0.9]], [[1.0]], plant.sensors))
    given = type(clean)(plant, clean.x, clean.u, clean.v, clean.y, clean.rngs)
    with pytest.raises(DesignError, match="A varies in time"):
        injected(WorstCase(1.0, on="a"), given)

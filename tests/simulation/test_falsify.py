"""Lies in recorded readings."""

import numpy as np
import pandas as pd
import pytest

from securestate import InputError, Plant, Sensor, ShapeError
from securestate.attacks import (
    Bias,
    DefenderReflection,
    Drawn,
    FakeState,
    Freeze,
    NoiseLinear,
    RandomNoise,
    Reflection,
)
from securestate.simulation import falsify, simulate


def plant(inputs: bool = False) -> Plant:
    sensors = [
        Sensor("pair", C=[[1.0, 0.0], [0.0, 1.0]], R=1.0, offset=[5.0, -2.0], scale=[2.0, 3.0]),
        Sensor("single", C=[1.0, 1.0], R=1.0),
        Sensor("third", C=[1.0, -1.0], R=1.0),
    ]
    return Plant([[0.9, 0.1], [0.0, 0.8]], np.eye(2), sensors, B=[[1.0], [0.0]] if inputs else None)


@pytest.mark.parametrize(
    "attack",
    [
        Bias(3.0, on="pair", start=4) + Freeze(on="single", start=2),
        RandomNoise(2.0, on=Drawn(2), start=1),
        FakeState((1.0, -1.0), on=["pair", "third"]),
        Reflection(on="single", start=3),
    ],
)
def test_a_record_is_falsified_as_its_simulation_would_be(attack: object) -> None:
    trajectory = simulate(plant(inputs=True), 30, attack, runs=4, seed=6)  # type: ignore[arg-type]
    lies = falsify(plant(inputs=True), trajectory.clean, attack, seed=6, u=trajectory.u)  # type: ignore[arg-type]
    np.testing.assert_array_equal(lies.y, trajectory.y)
    np.testing.assert_array_equal(lies.a, trajectory.a)
    np.testing.assert_array_equal(lies.attacked, trajectory.attacked)


def test_a_single_record_keeps_its_shape_and_a_table_is_read_by_name() -> None:
    y = np.arange(20.0).reshape(5, 4)
    table = pd.DataFrame(y, columns=plant().channel_names)[["third", "pair.2", "single", "pair.1"]]
    for given in (y, table):
        lies = falsify(plant(), given, Bias(1.0, on="third", start=2), seed=1)
        np.testing.assert_array_equal(lies.y - y, lies.a)
        np.testing.assert_array_equal(lies.a[:, 3], [0.0, 0.0, 1.0, 1.0, 1.0])
        assert lies.attacked.shape == (5, 3)


def test_a_missing_reading_stays_missing() -> None:
    y = np.zeros((3, 4))
    y[1, 2] = np.nan
    lies = falsify(plant(), y, Bias(1.0, on="single"), seed=1)
    np.testing.assert_array_equal(lies.y[:, 2], [1.0, np.nan, 1.0])


@pytest.mark.parametrize(
    "attack", [NoiseLinear(on=0), DefenderReflection(on=0), Bias(1.0, on=0) + NoiseLinear(on=1)]
)
def test_an_adversary_that_needs_the_truth_is_refused(attack: object) -> None:
    with pytest.raises(
        InputError, match="attack: expected adversaries that know what a record holds, received"
    ):
        falsify(plant(), np.zeros((3, 4)), attack, seed=1)  # type: ignore[arg-type]


def test_wrong_shapes_are_named() -> None:
    with pytest.raises(ShapeError, match="y: expected shape"):
        falsify(plant(), np.zeros((3, 5)), Bias(1.0, on=0), seed=1)
    with pytest.raises(ShapeError, match="u: expected shape"):
        falsify(plant(inputs=True), np.zeros((3, 4)), Bias(1.0, on=0), seed=1)
    with pytest.raises(InputError, match="attack: expected an Attack"):
        falsify(plant(), np.zeros((3, 4)), "bias", seed=1)  # type: ignore[arg-type]

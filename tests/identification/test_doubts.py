"""What `identify` and `judge` do not claim: inputs, copies, few samples or equal parties leave it open."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from numpy.typing import NDArray

from securestate import BiasMonitor, Plant, SecurestateWarning, Sensor, identify, judge, simulate
from securestate.errors import InputError, MeasurementError
from securestate.identification import Grade
from securestate.identification.history import History
from securestate.identification.prepare import prepare
from securestate.identification.rehearsal import suspected_shares
from securestate.identification.verdict import rehearsed

Array = NDArray[np.float64]


def slow(rng: np.random.Generator, a: float, N: int) -> Array:
    x = np.zeros(N)
    for k in range(1, N):
        x[k] = a * x[k - 1] + np.sqrt(1 - a**2) * rng.normal()
    return x


@pytest.mark.filterwarnings("ignore::securestate.SecurestateWarning")
@pytest.mark.parametrize("a", [0.9, 0.97])
def test_a_slow_reading_is_not_verifiable_because_its_controller_repeats_it_a_sample_later(a: float) -> None:
    rng = np.random.default_rng(5)
    level, acidity = slow(rng, 0.9, 1500), slow(rng, a, 1500)
    pH = 7 + 0.1 * acidity + 0.003 * rng.normal(size=1500)
    acid = 20 - 30 * (pH - 7) + 0.03 * rng.normal(size=1500)
    y = np.column_stack([pH, level + 0.1 * rng.normal(size=1500), level + 0.1 * rng.normal(size=1500)])
    with pytest.warns(SecurestateWarning, match="Without the inputs the other sensors do not vouch for pH:"):
        found = identify(y, acid[:, None], channel_names=["pH", "level 1", "level 2"], input_names=["acid"])
    assert found.verdict.sensors[0].explained > 0.5
    assert found.verdict.verifiable == ("level 1", "level 2")
    assert found.plant.verifiable.tolist() == [False, True, True]


def twins(m: int) -> tuple[Plant, Array]:
    """m equal sensors of one state, and an honest record."""
    plant = Plant([[0.95]], [[0.1]], [Sensor(f"s{i}", C=[1.0], R=0.1) for i in range(m)])
    return plant, simulate(plant, 1000, seed=4).y[0]


@pytest.mark.parametrize(("m", "liars"), [(2, [0]), (4, [2, 3]), (6, [0, 1, 2])])
def test_nobody_is_blamed_where_as_many_speak_for_it_as_against(m: int, liars: list[int]) -> None:
    plant, y = twins(m)
    y[:, liars] += 2.0
    verdict = judge(plant, y)
    assert (verdict.grade, verdict.blamed) == (Grade.INADEQUATE, ())
    assert "record cannot tell who is wrong" in verdict.reason


def test_a_minority_is_blamed() -> None:
    plant, y = twins(5)
    y[:, [1, 3]] += 2.0
    verdict = judge(plant, y)
    assert verdict.blamed == ("s1", "s3")
    assert verdict.reason in {str(problem) for problem in verdict.problems}


def test_few_readings_say_nothing_of_who_can_be_checked() -> None:
    found = identify(np.random.default_rng(1).normal(size=(150, 3)))
    assert found.verdict.verifiable == ()
    assert np.isnan([sensor.explained for sensor in found.verdict.sensors]).all()
    assert "Too few readings to say which sensors the others can check." in str(found)
    assert found.verdict.grade is not Grade.GOOD


def test_a_true_plant_is_hardly_ever_called_less_than_usable_by_few_samples() -> None:
    plant, _ = twins(4)
    grades = [judge(plant, y).grade for y in simulate(plant, 80, seed=7, runs=60).y]
    assert grades.count(Grade.INADEQUATE) == 0
    assert grades.count(Grade.USABLE) <= 6


def test_inputs_that_depend_on_others_are_left_out() -> None:
    rng = np.random.default_rng(2)
    u = rng.normal(size=(400, 1))
    doubled = np.hstack([u, 3 - 2 * u, rng.normal(size=(400, 1))])
    found = prepare(History.of(rng.normal(size=(400, 2)), doubled))
    assert found.inputs.tolist() == [0, 2]
    assert found.remarks == ("1 input without a change of its own left out: u2.",)


def test_a_channel_that_gets_stuck_is_said_and_a_coarse_one_is_not() -> None:
    rng = np.random.default_rng(3)
    y = np.column_stack([rng.normal(size=2000), np.round(slow(rng, 0.99, 2000))])
    assert prepare(History.of(y)).remarks == ()
    y[500:900, 0] = y[500, 0]
    assert prepare(History.of(y)).remarks == ("y1 keeps one value for 400 samples: was it stuck?",)


def test_a_rounded_copy_with_other_gaps_is_one_sensor_and_nobody_lies() -> None:
    rng = np.random.default_rng(6)
    x = slow(rng, 0.95, 1500)
    celsius = np.round(60 + 2 * x, 2)
    y = np.column_stack(
        [celsius, x + 0.3 * rng.normal(size=1500), x + 0.3 * rng.normal(size=1500), 32 + 1.8 * celsius]
    )
    y[rng.random(y.shape) < 0.03] = np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SecurestateWarning)
        found = identify(y)
    assert found.plant.sensor_names == ("y1 + y4", "y2", "y3")
    shares = suspected_shares(found.plant, [(y[:, [0, 3, 1, 2]], np.zeros((1500, 0)))])
    assert shares is not None and shares.max() < 0.02


def test_an_estimator_that_suspects_an_honest_sensor_costs_the_grade() -> None:
    plant, y = twins(5)
    verdict = judge(plant, y)
    assert (verdict.grade, verdict.criteria[-1].grade) == (Grade.GOOD, Grade.GOOD)
    y[:, 4] += 2.0
    shares = suspected_shares(plant, [(y, np.zeros((1000, 0)))])
    assert shares is not None and shares[4] > 0.5 and shares[:4].max() < 0.03
    found = rehearsed(shares, plant.sensor_names)
    assert (found.grade, found.channel) == (Grade.INADEQUATE, "s4")
    assert found.text.startswith("Sparse fusion suspects s4 in ")


def test_what_cannot_be_computed_is_refused_by_name() -> None:
    y = np.random.default_rng(1).normal(size=(100, 2))
    with pytest.raises(InputError, match="order: expected at most"):
        identify(y, order=300)
    with pytest.raises(InputError, match="held_out_u: expected None without held_out"):
        identify(y, held_out_u=y)


@pytest.mark.filterwarnings("ignore::securestate.SecurestateWarning")
def test_readings_without_noise_are_refused_or_called_inadequate() -> None:
    phase = 0.1 * np.arange(400.0)
    for y in (
        [np.sin(phase), np.cos(phase)],
        [np.sin(phase), np.cos(phase), np.sin(phase + 0.3)],
        [phase, -phase],
    ):
        try:
            found = identify(np.column_stack(y))
        except MeasurementError as refused:
            assert "readings with noise" in str(refused)
        else:
            assert found.verdict.grade is not Grade.GOOD


def test_a_monitor_that_can_name_nobody_says_so() -> None:
    plant, _ = twins(3)
    mute = Plant(plant.A, plant.Q, [sensor.replaced(verifiable=False) for sensor in plant.sensors])
    with pytest.warns(SecurestateWarning, match="nobody can be named"):
        BiasMonitor(mute)

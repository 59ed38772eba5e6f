"""The verdict: the truth is good, whatever differs from it is not, and the sentence says what is wrong."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from securestate import DesignError, InputError, Plant, Sensor, ShapeError
from securestate.identification import Grade, History, Verdict, identify, judge
from securestate.identification.forms import Independent
from tests.identification.identification_cases import (
    KNOWN,
    LEVEL,
    SIZE,
    engineering,
    plant_of,
    record,
    with_gaps,
)
from tests.reference.kalman import textbook_filter

Array = NDArray[np.float64]
NAN = float("nan")
PLANT_CHANGED = "more likely the plant has changed, or was never what the model says, than that sensors lie"


def in_units(model: Independent) -> Plant:
    """The plant with the operating point of `engineering`."""
    plant = plant_of(model, input_offset=50.0, input_scale=4.0)
    return Plant(
        plant.A,
        plant.Q,
        [s.replaced(offset=LEVEL[i], scale=SIZE[i]) for i, s in enumerate(plant.sensors)],
        B=plant.B,
        input_offset=50.0,
        input_scale=4.0,
    )


TRUTH = in_units(KNOWN)


def of(model: Independent, N: int = 2000, seed: int = 1) -> tuple[Array, Array]:
    return engineering(record(model, N, seed))


@pytest.fixture(scope="module")
def on_truth() -> Verdict:
    return judge(TRUTH, *of(KNOWN))


def test_the_true_plant_is_good_on_its_own_data() -> None:
    """At most one record in twenty may look otherwise."""
    grades = [judge(TRUTH, *of(KNOWN, 1500, seed)).grade for seed in range(20)]
    assert sum(grade is not Grade.GOOD for grade in grades) <= 1


def test_the_numbers_of_the_truth_are_those_of_white_noise_of_the_size_it_says(on_truth: Verdict) -> None:
    found = on_truth.residuals
    readings = found.counted.sum()
    assert found.samples == 1980  # the first twenty are not judged
    assert found.size == pytest.approx(1, abs=4 * np.sqrt(2 / readings))
    assert found.exceed == pytest.approx(0.05, abs=4 * np.sqrt(0.05 * 0.95 / 1980))
    np.testing.assert_allclose(found.variance, 1, atol=4 * np.sqrt(2 / 1980))
    assert np.max(np.abs(found.repeat)) < 4.5 / np.sqrt(1980)
    assert np.max(np.abs(found.shift)) < 4 / np.sqrt(1980)
    assert found.ljung_box.min() > 1e-4
    assert on_truth.problems == ()


def test_what_the_others_explain_is_what_the_law_of_the_plant_says(on_truth: Verdict) -> None:
    """In a record: 1 - E (y_i - E[y_i | the others up to now])^2 / var y_i, by a filter without it."""
    y, u = record(KNOWN, 3000, 3)
    deaf = y.copy()
    deaf[:, 0] = NAN
    plant = plant_of(KNOWN)
    book = textbook_filter(plant, deaf, u, np.zeros(2), np.eye(2))
    remains = (y[:, 0] - book.x @ KNOWN.C[0])[50:]
    expected = 1 - remains.var() / y[50:, 0].var()
    assert judge(plant, y, u).sensors[0].explained == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        (replace(KNOWN, Q=2 * KNOWN.Q, r=2 * KNOWN.r), "Prediction errors have 2"),
        (replace(KNOWN, Q=0.3 * KNOWN.Q, r=0.3 * KNOWN.r), "Prediction errors have 0.3"),
        (replace(KNOWN, A=np.array([[0.5, 0.8], [-0.8, 0.5]])), "Prediction errors have"),
        (replace(KNOWN, B=6 * KNOWN.B), "Prediction errors have"),
    ],
    ids=["louder", "quieter", "other dynamics", "other effect of the input"],
)
def test_a_plant_that_differs_is_inadequate_and_the_sentence_says_how(
    changed: Independent, said: str
) -> None:
    verdict = judge(TRUTH, *of(changed))
    assert verdict.grade is Grade.INADEQUATE
    assert said in str(verdict)
    assert verdict.blamed == ()
    if verdict.residuals.size > 1.5:
        assert PLANT_CHANGED in str(verdict)


def test_a_moved_operating_point_is_inadequate_though_every_prediction_follows_it() -> None:
    y, u = of(KNOWN)
    slow = np.linalg.solve(np.eye(2) - KNOWN.A, np.array([2.0, 2.0]))
    verdict = judge(TRUTH, y + SIZE * (KNOWN.C @ slow), u)
    assert verdict.grade is Grade.INADEQUATE
    assert "The plant is elsewhere than where the model was made" in str(verdict)
    assert verdict.blamed == ()


def flexible_structure(seed: int) -> Array:
    """Three accelerometers on a structure of twelve lightly damped modes, driven by noise."""
    rng = np.random.default_rng(seed)
    turns, N = np.linspace(0.2, 2.8, 12), 1500
    y = 0.05 * rng.normal(size=(N, 3))
    for turn, C in zip(turns, np.random.default_rng(0).normal(size=(12, 3, 2)), strict=True):
        A = 0.985 * np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        x, w = np.zeros(2), rng.normal(size=(N, 2))
        for k in range(N):
            y[k] += C @ x
            x = A @ x + w[k]
    return y


@pytest.mark.parametrize("order", [4, 8])
def test_a_structure_with_more_modes_than_the_model_is_inadequate_for_its_errors_come_back(
    order: int,
) -> None:
    verdict = identify(flexible_structure(1), order=order).verdict
    assert verdict.grade is Grade.INADEQUATE
    assert "the model lacks dynamics" in str(verdict)
    assert verdict.residuals.size < 1.5  # their size alone would not have told


@pytest.mark.parametrize("liar", range(4))
@pytest.mark.parametrize("missing", [0.0, 0.1])
def test_one_lying_sensor_is_blamed_by_name(liar: int, missing: float) -> None:
    y, u = of(KNOWN)
    y[:, liar] += 6 * SIZE[liar] * np.sin(np.arange(2000) / 7)
    verdict = judge(TRUTH, with_gaps(y, missing, liar), u)
    assert verdict.grade is Grade.INADEQUATE
    assert verdict.blamed == (f"s{liar + 1}",)
    assert f"Without s{liar + 1} the rest fits: more likely this sensor is wrong" in str(verdict)


def test_a_blamed_sensor_does_not_vouch_for_others() -> None:
    y, u = of(KNOWN)
    y[:, 3] += 20 * np.sin(np.arange(2000) / 7)
    verdict = judge(TRUTH, y, u)
    honest = judge(TRUTH, np.where(np.arange(4) == 3, NAN, y), u)
    assert verdict.blamed == ("s4",)
    shares = [[sensor.explained for sensor in each.sensors[:3]] for each in (verdict, honest)]
    np.testing.assert_allclose(shares[0], shares[1], atol=1e-9)


@pytest.mark.parametrize("share", [0.05, 0.5])
def test_missing_samples_leave_the_truth_good(share: float) -> None:
    y, u = of(KNOWN)
    gappy = with_gaps(y, share, 2)
    gappy[100:130] = NAN
    verdict = judge(TRUTH, gappy, u)
    assert verdict.grade is Grade.GOOD
    assert verdict.residuals.channels.sum() == np.isfinite(gappy[20:]).sum()


def test_segments_are_judged_each_from_its_own_start() -> None:
    parts = [of(KNOWN, 300, seed) for seed in range(6)]
    verdict = judge(TRUTH, [y for y, _ in parts], [u for _, u in parts])
    assert verdict.grade is Grade.GOOD
    assert verdict.residuals.samples == 6 * 280
    joined = judge(TRUTH, np.vstack([y for y, _ in parts]), np.vstack([u for _, u in parts]))
    assert joined.residuals.samples == 1780


def test_a_sensor_that_nobody_else_sees_cannot_be_checked_and_twins_can() -> None:
    lonely = Independent(
        np.diag([0.9, 0.9]), np.zeros((2, 0)), np.array([[1.0, 0], [1, 0], [0, 1]]), np.zeros((3, 0)),
        np.diag([0.2, 0.2]), np.array([0.1, 0.1, 0.1]),
    )  # fmt: skip
    verdict = judge(plant_of(lonely), record(lonely, 2000, 5)[0])
    assert verdict.grade is Grade.GOOD
    assert verdict.verifiable == ("s1", "s2")
    assert abs(verdict.sensors[2].explained) < 0.05  # its mean is not exactly zero
    assert "2 of 3 sensors can be checked by the others: s1 and s2." in str(verdict)


def test_a_sensor_that_was_hardly_read_cannot_be_checked() -> None:
    y, u = of(KNOWN)
    y[40:, 1] = NAN
    evidence = judge(TRUTH, y, u).sensors[1]
    assert np.isnan([evidence.explained, evidence.explained_least]).all()
    assert not evidence.verifiable


def test_explained_least_is_below_what_a_very_long_record_says_in_ninety_percent_of_records() -> None:
    """95 % is wanted; 90 % of 60 short records is 1.8 standard errors less."""
    two = Independent(
        np.array([[0.8]]),
        np.zeros((1, 0)),
        np.ones((2, 1)),
        np.zeros((2, 0)),
        np.array([[0.36]]),
        np.full(2, 0.5),
    )
    plant = plant_of(two)
    truth = judge(plant, record(two, 20_000, 0)[0]).sensors[0].explained
    least = [judge(plant, record(two, 500, seed)[0]).sensors[0].explained_least for seed in range(1, 61)]
    assert np.mean(np.array(least) <= truth) >= 0.9
    assert np.mean(least) > truth - 0.15


def test_the_only_sensor_has_nobody_to_check_it() -> None:
    one = replace(KNOWN, C=KNOWN.C[:1], D=KNOWN.D[:1], r=KNOWN.r[:1])
    verdict = judge(plant_of(one), *record(one, 1000, 1))
    assert "There is no other sensor that could check s1." in str(verdict)
    assert verdict.blamed == ()


def test_columns_come_in_any_order_if_they_have_names() -> None:
    y, u = of(KNOWN, 500)
    names = ["s4", "s2", "s1", "s3", "other"]
    mixed = History.of(np.column_stack([y[:, [3, 1, 0, 2]], y[:, 0]]), u, channel_names=names)
    assert np.array_equal(judge(TRUTH, mixed).residuals.nis, judge(TRUTH, y, u).residuals.nis)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (("no plant", np.zeros((9, 4))), InputError, "plant: expected a Plant, received str"),
        (
            (TRUTH, np.zeros((9, 3)), np.zeros((9, 1))),
            ShapeError,
            "y: expected 4 channels, as the plant has, received 3",
        ),
        ((TRUTH, np.zeros((9, 4))), ShapeError, "u: expected 1 input, as the plant has, received 0"),
        (
            (TRUTH, np.zeros((9, 4)), np.zeros((8, 1))),
            ShapeError,
            "u: expected 9 samples, as y has, received 8",
        ),
        (
            (TRUTH, History.of(np.zeros((9, 4)), np.zeros((9, 1)), dt=60.0)),
            InputError,
            "y.dt: expected 1 s between samples, as the plant has, received 60 s",
        ),
        (
            (TRUTH, History.of(np.zeros((9, 2)), np.zeros((9, 1)), channel_names=["s1", "x"])),
            InputError,
            "y: expected a column 's2', received s1, x",
        ),
        (
            (Plant(np.diag([1.2, 0.5]), np.eye(2), [Sensor("blind", C=[0, 1], R=1.0)]), np.zeros((9, 1))),
            DesignError,
            "no sensor sees",
        ),
    ],
)
def test_a_mistake_names_argument_expected_and_received(
    arguments: tuple[Any, ...], error: type[Exception], message: str
) -> None:
    with pytest.raises(error) as caught:
        judge(*arguments)
    assert message in str(caught.value)


def test_a_record_without_a_reading_is_inadequate() -> None:
    verdict = judge(TRUTH, np.full((100, 4), NAN), np.zeros((100, 1)))
    assert verdict.grade is Grade.INADEQUATE
    assert "There is no sample to judge the model by." in str(verdict)

"""Plants known in part: what is fixed stays, and the fit never makes a plant worse."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from securestate import DesignError, InputError, MeasurementError, Plant, PlantError, Sensor, ShapeError
from securestate.identification import judge, refine
from securestate.identification.forms import Independent
from tests.identification.identification_cases import KNOWN, model_of, plant_of, record, with_gaps
from tests.reference.kalman import textbook_filter

Array = NDArray[np.float64]
NAN = float("nan")
Y, U = record(KNOWN, 1200, 1)
FRESH = record(KNOWN, 2000, 2)
WRONG = replace(KNOWN, Q=np.diag([0.02, 3.0]), r=np.array([2.0, 0.05, 1.0, 0.1]))


def likelihood(plant: Plant, y: Array, u: Array) -> float:
    """Per sample, by a filter of the textbook that starts from rest."""
    return float(textbook_filter(plant, y, u, np.zeros(plant.n), np.eye(plant.n)).log_likelihood[20:].mean())


def test_wrong_noises_are_put_right_and_everything_else_stays_to_the_bit() -> None:
    given = plant_of(WRONG)
    found = refine(given, Y, U)
    assert found.improved
    assert found.after > found.before
    for name in "ABCD":
        assert np.array_equal(getattr(found.plant, name), getattr(given, name))
    np.testing.assert_allclose(np.diag(found.plant.R), KNOWN.r, rtol=0.15)
    np.testing.assert_allclose(found.plant.Q, KNOWN.Q, atol=0.07)
    best = likelihood(plant_of(KNOWN), *FRESH)
    assert best - likelihood(found.plant, *FRESH) < 0.01 < 0.5 < best - likelihood(given, *FRESH)
    assert judge(found.plant, *FRESH).grade == "good"
    assert "Refined: from" in str(found)


def test_the_numbers_are_those_of_the_textbooks_filter() -> None:
    """On the last quarter, which is not fitted; the start, which is found in another way, counts little."""
    found = refine(plant_of(WRONG), Y, U)
    kept = Y[900:], U[900:]
    assert found.before == pytest.approx(likelihood(plant_of(WRONG), *kept), abs=0.2)
    assert found.after - found.before == pytest.approx(
        likelihood(found.plant, *kept) - likelihood(plant_of(WRONG), *kept), abs=0.2
    )
    assert np.all(np.diff(found.likelihoods) >= 0)


@pytest.mark.parametrize("missing", [0.0, 0.1])
def test_fixed_entries_stay_to_the_bit_whatever_else_is_free(missing: float) -> None:
    rng = np.random.default_rng(3)
    start = replace(KNOWN, A=KNOWN.A * 0.9, C=KNOWN.C * 1.1, r=KNOWN.r * 2, Q=np.diag([0.3, 0.3]))
    given = plant_of(start)
    free = {name: rng.random(getattr(given, name).shape) < 0.5 for name in "ABC"}
    free["Q"] = np.diag([True, False])
    free["R"] = np.diag([True, False, True, False])
    found = refine(given, with_gaps(Y[:600], missing, 1), U[:600], free=free, steps=15)
    assert found.improved
    for name in "ABCQR":
        new, old = getattr(found.plant, name), getattr(given, name)
        assert np.array_equal(new[~free[name]], old[~free[name]]), name
        if free[name].any():
            assert np.any(new[free[name]] != old[free[name]]), name
    assert np.array_equal(found.plant.D, given.D)


def test_names_units_and_operating_point_stay() -> None:
    sensors = [
        Sensor(
            "pair",
            C=KNOWN.C[:2],
            R=np.diag([1.0, 1.0]),
            unit=["m", "K"],
            offset=[5, 6],
            scale=[2, 3],
            protected=True,
        ),
        Sensor("third", C=KNOWN.C[2:], R=np.eye(2), verifiable=False),
    ]
    given = Plant(
        KNOWN.A, KNOWN.Q, sensors, B=KNOWN.B, dt=60.0, state_names=["warm", "wet"], input_names=["valve"],
        input_offset=50.0, input_scale=4.0, name="tank",
    )  # fmt: skip
    y = Y * [2, 3, 1, 1] + [5, 6, 0, 0]
    found = refine(given, y, 50 + 4 * U, steps=5)
    assert found.improved
    plant = found.plant
    for name in (
        "sensor_names",
        "channel_names",
        "units",
        "state_names",
        "input_names",
        "dt",
        "name",
        "protected",
    ):
        assert np.array_equal(getattr(plant, name), getattr(given, name)), name
    for name in ("offset", "scale", "input_offset", "input_scale"):
        assert np.array_equal(getattr(plant, name), getattr(given, name)), name
    assert [s.verifiable for s in plant.sensors] == [s.verifiable for s in given.sensors]


def random_start(seed: int) -> Plant:
    """The truth, or somewhere around it."""
    rng, far = np.random.default_rng(seed), seed % 3
    return plant_of(
        Independent(
            KNOWN.A + 0.05 * far * rng.normal(size=(2, 2)),
            KNOWN.B,
            KNOWN.C + 0.1 * far * rng.normal(size=(4, 2)),
            KNOWN.D,
            KNOWN.Q * np.exp(far * rng.normal()),
            KNOWN.r * np.exp(far * rng.normal(size=4)),
        )
    )


def test_no_start_ends_worse_on_the_samples_kept_back() -> None:
    """Few samples and nearly everything free, so that some fits are worse than what was given."""
    improved = []
    for seed in range(30):
        given, (y, u) = random_start(seed), record(KNOWN, 80, seed)
        found = refine(given, y, u, free=["A", "C", "Q", "R"], steps=8)
        before, after = (likelihood_from_start(plant, y[60:], u[60:]) for plant in (given, found.plant))
        improved.append(found.improved)
        assert found.improved == (found.after > found.before)
        if found.improved:
            assert after > before - 0.3  # the textbook starts in another way, which 20 samples feel
            assert "Refined: from" in str(found)
        else:
            assert found.plant is given
            assert "Not refined" in str(found)
    assert True in improved
    assert False in improved


def likelihood_from_start(plant: Plant, y: Array, u: Array) -> float:
    return float(textbook_filter(plant, y, u, np.zeros(plant.n), 4 * np.eye(plant.n)).log_likelihood.mean())


def test_another_record_decides_if_there_is_one() -> None:
    given = plant_of(WRONG)
    other = record(replace(KNOWN, r=100 * KNOWN.r), 300, 5)
    found = refine(given, Y[:400], U[:400], held_out=other[0], held_out_u=other[1], steps=20)
    assert found.before == pytest.approx(likelihood(given, *other), rel=0.1)
    assert abs(likelihood(given, Y, U)) < 0.1 * abs(found.before)  # what the end of y would have said


def test_missing_readings_are_no_hindrance() -> None:
    found = refine(plant_of(WRONG), with_gaps(Y[:800], 0.2, 3), U[:800], steps=30)
    np.testing.assert_allclose(np.diag(found.plant.R), KNOWN.r, rtol=0.3)


def test_noises_of_states_are_free_in_blocks_and_zero_between_them() -> None:
    big = Independent(
        np.diag([0.9, 0.8, 0.7]), np.zeros((3, 0)), np.vstack([np.eye(3), np.ones((1, 3))]), np.zeros((4, 0)),
        np.array([[0.5, 0.3, 0.0], [0.3, 0.5, 0.0], [0.0, 0.0, 0.2]]), np.full(4, 0.1),
    )  # fmt: skip
    y, _ = record(big, 1500, 4)
    table = np.array([[1, 1, 0], [1, 1, 0], [0, 0, 1]], dtype=bool)
    found = refine(plant_of(replace(big, Q=0.3 * np.eye(3))), y, free={"Q": table})
    np.testing.assert_allclose(found.plant.Q, big.Q, atol=0.06)
    assert not found.plant.Q[~table].any()


def test_free_matrices_come_as_names_tables_or_true() -> None:
    given, part = plant_of(WRONG), (Y[:300], U[:300])
    by_name = refine(given, *part, free=["R"], steps=5).plant
    for free in ({"R": True}, {"R": np.eye(4, dtype=bool)}, {"R": True, "Q": False}):
        assert np.array_equal(refine(given, *part, free=free, steps=5).plant.R, by_name.R)
    assert np.array_equal(by_name.Q, given.Q)


PLANT = plant_of(KNOWN)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"plant": model_of(PLANT)}, InputError, "plant: expected a Plant, received Independent"),
        ({"free": ["S"]}, InputError, "free: expected names among A, B, C, D, Q, R, received 'S'"),
        ({"free": []}, InputError, "free: expected at least one entry that may change, received none"),
        ({"free": {"A": np.zeros((2, 2), dtype=bool)}}, InputError, "free: expected at least one entry"),
        (
            {"free": {"A": np.ones((2, 2))}},
            InputError,
            "free['A']: expected True, False or such a table of shape (2, 2)",
        ),
        (
            {"free": {"A": [True]}},
            InputError,
            "free['A']: expected True, False or such a table of shape (2, 2), rec",
        ),
        ({"free": {"Q": [[True, True], [False, True]]}}, InputError, "free['Q']: expected a symmetric table"),
        (
            {"free": {"Q": np.diag([True, False])}},
            InputError,
            "free['Q']: expected whole blocks of states, with zeros",
        ),
        (
            {"free": {"Q": [[False, True], [True, False]]}},
            InputError,
            "free['Q']: expected whole blocks of states",
        ),
        ({"u": None}, ShapeError, "u: expected 1 input, as the plant has, received 0"),
        (
            {"y": Y[:12], "u": U[:12]},
            MeasurementError,
            "y: expected enough samples to fit and to judge, received",
        ),
        (
            {
                "plant": Plant(
                    np.diag([1.2, 0.5]),
                    np.eye(2),
                    [Sensor(f"s{i}", C=[0, 1], R=1) for i in range(4)],
                    B=KNOWN.B,
                )
            },
            DesignError,
            "the plant has no stationary filter",
        ),
        (
            {"plant": Plant(KNOWN.A, KNOWN.Q, [Sensor("all", C=KNOWN.C, R=np.eye(4) + 0.1)], B=KNOWN.B)},
            PlantError,
            "plant: expected channels whose noises do not depend on each other, received an R that couples",
        ),
        (
            {"plant": Plant(np.stack([KNOWN.A] * 3), KNOWN.Q, PLANT.sensors, B=KNOWN.B)},
            DesignError,
            "the plant varies in time",
        ),
    ],
)
def test_a_mistake_names_argument_expected_and_received(
    arguments: dict[str, Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error) as caught:
        refine(**{"plant": PLANT, "y": Y, "u": U, **arguments})
    assert message in str(caught.value)

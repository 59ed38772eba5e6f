"""Plants learned from records whose truth is known."""

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from scipy import linalg
from threadpoolctl import threadpool_limits

from securestate import InputError, MeasurementError, Plant, SecurestateWarning, ShapeError
from securestate.identification import Grade, History, Identified, identify, judge
from securestate.identification.forms import Independent
from securestate.identification.residuals import residuals
from tests.identification.identification_cases import KNOWN, SIZE, engineering, record, with_gaps

Array = NDArray[np.float64]
NAN = float("nan")
FRESH = engineering(record(KNOWN, 3000, 100))


def learn(N: int = 1500, seed: int = 1, **options: Any) -> Identified:
    y, u = engineering(record(KNOWN, N, seed))
    return identify(y, u, **{"order": 2, **options})


def noise_of(plant: Plant) -> Array:
    """Standard deviation of every sensor's own noise, engineering units."""
    return np.asarray(plant.scale * np.sqrt(np.diag(plant.R)))


def error(plant: Plant) -> Array:
    """Root mean square of one-step prediction errors on fresh complete data, in the sensors' units."""
    y, u = FRESH
    found = residuals(plant, [(y, u)])
    run = found.segments[0] * innovation_std(plant)
    return np.asarray(np.sqrt(np.mean(run**2, axis=0)))


def innovation_std(plant: Plant) -> Array:
    P = linalg.solve_discrete_are(plant.A.T, plant.C.T, plant.Q, plant.R)
    return np.asarray(plant.scale * np.sqrt(np.diag(plant.C @ P @ plant.C.T + plant.R)))


def effect_of_the_input(A: Array, B: Array, C: Array, y_scale: Array, u_scale: float) -> Array:
    """What an input of one engineering unit does to every channel in the next ten samples, (10, m)."""
    return np.array([y_scale * (C @ np.linalg.matrix_power(A, k) @ B / u_scale)[:, 0] for k in range(10)])


@pytest.fixture(scope="module")
def found() -> Identified:
    return learn(order="auto")


def test_the_order_eigenvalues_and_noises_of_a_known_plant_are_recovered_in_engineering_units(
    found: Identified,
) -> None:
    plant = found.plant
    assert found.verdict.grade is Grade.GOOD
    assert (plant.n, found.search.order) == (2, 2)
    np.testing.assert_allclose(
        np.sort_complex(np.linalg.eigvals(plant.A)), np.sort_complex(np.linalg.eigvals(KNOWN.A)), atol=0.02
    )
    np.testing.assert_allclose(noise_of(plant), SIZE * np.sqrt(KNOWN.r), rtol=0.1)


def test_the_operating_point_is_that_of_the_record(found: Identified) -> None:
    y, u = engineering(record(KNOWN, 1500, 1))
    np.testing.assert_allclose(found.plant.offset, y.mean(axis=0))
    np.testing.assert_allclose(found.plant.scale, y.std(axis=0))
    np.testing.assert_allclose(found.plant.input_offset, u.mean(axis=0))


def test_the_effect_of_an_input_is_recovered_in_engineering_units() -> None:
    driven = replace(KNOWN, B=5 * KNOWN.B)
    plant = identify(*engineering(record(driven, 1500, 1)), order=2).plant
    learned = effect_of_the_input(plant.A, plant.B, plant.C, plant.scale, float(plant.input_scale[0]))
    true = effect_of_the_input(driven.A, driven.B, driven.C, SIZE, 4.0)
    assert np.max(np.abs(learned - true) / np.abs(true).max(axis=0)) < 0.05
    assert not plant.D.any()


def test_its_one_step_errors_on_fresh_data_are_those_of_the_true_filter(found: Identified) -> None:
    P = linalg.solve_discrete_are(KNOWN.A.T, KNOWN.C.T, KNOWN.Q, np.diag(KNOWN.r))
    best = SIZE * np.sqrt(np.diag(KNOWN.C @ P @ KNOWN.C.T + np.diag(KNOWN.r)))
    np.testing.assert_allclose(error(found.plant), best, rtol=0.05)
    assert judge(found.plant, *FRESH).grade is Grade.GOOD


def test_likelihoods_never_fall_and_the_noise_is_never_lowered(found: Identified) -> None:
    assert np.all(np.diff(found.likelihoods) >= 0)
    assert found.noise_factor >= 1


def test_the_same_data_give_the_same_bits_again(found: Identified) -> None:
    again = learn(order="auto")
    assert_same_bits(found.plant, again.plant)
    assert str(found) == str(again)


def assert_same_bits(one: Plant, other: Plant) -> None:
    for name in ("A", "B", "C", "Q", "R", "offset", "scale"):
        assert np.array_equal(getattr(one, name), getattr(other, name)), name


def test_any_number_of_threads_gives_the_same_bits() -> None:
    rng = np.random.default_rng(1)
    x = np.zeros((600, 2))
    for k in range(1, 600):
        x[k] = KNOWN.A @ x[k - 1] + rng.normal(size=2)
    y = x @ rng.normal(size=(2, 40)) + rng.normal(size=(600, 40))
    plants = []
    for threads in (1, 3):
        with threadpool_limits(threads, user_api="blas"):
            plants.append(identify(y, order=2).plant)
    assert_same_bits(*plants)


def test_the_order_given_is_the_order_and_nothing_else_is_tried() -> None:
    given = learn(500, order=3)
    assert given.plant.n == given.search.order == 3
    assert set(given.search.independent) == {3}


def test_five_segments_are_as_good_as_one_record(found: Identified) -> None:
    parts = [engineering(record(KNOWN, 300, seed)) for seed in range(10, 15)]
    several = identify([y for y, _ in parts], [u for _, u in parts], order=2)
    assert several.verdict.grade is Grade.GOOD
    np.testing.assert_allclose(error(several.plant), error(found.plant), rtol=0.03)


def test_inputs_that_stop_in_between_split_the_record_and_do_no_harm(found: Identified) -> None:
    y, u = engineering(record(KNOWN, 1500, 1))
    u[400:404] = u[900:904] = NAN
    stopped = identify(y, u, order=2)
    assert stopped.samples == 1492
    np.testing.assert_allclose(error(stopped.plant), error(found.plant), rtol=0.02)


@pytest.fixture(scope="module")
def gappy() -> Identified:
    y, u = engineering(record(KNOWN, 1500, 1))
    return identify(with_gaps(y, 0.1, 5), u, order=2)


def test_ten_percent_missing_readings_hardly_hurt(found: Identified, gappy: Identified) -> None:
    assert gappy.missing == pytest.approx(0.1, abs=0.02)
    assert gappy.verdict.grade is not Grade.INADEQUATE
    np.testing.assert_allclose(error(gappy.plant), error(found.plant), rtol=0.1)
    np.testing.assert_allclose(noise_of(gappy.plant), SIZE * np.sqrt(KNOWN.r), rtol=0.15)


def test_two_hundred_samples_of_many_channels_are_too_few_and_it_is_said() -> None:
    rng = np.random.default_rng(3)
    wide = Independent(
        linalg.block_diag(0.9, KNOWN.A, 0.7), np.zeros((4, 0)), rng.normal(size=(5, 4)), np.zeros((5, 0)),
        0.3 * np.eye(4), np.full(5, 0.5),
    )  # fmt: skip
    few = identify(record(wide, 200, 1)[0], order=4)
    assert few.verdict.grade is not Grade.GOOD
    assert "Too little data: the model has so many parameters" in str(few.verdict)
    many = identify(record(wide, 2000, 1)[0], order=4)
    assert "Too little data" not in str(many.verdict)


def test_rounded_readings_have_the_noise_of_their_rounding() -> None:
    """A meter without noise of its own that shows whole steps, beside a noisy one."""
    y, _ = record(replace(KNOWN, r=np.array([1e-6, 0.2, 0.3, 0.5])), 1500, 1)
    y[:, 0] = np.round(y[:, 0])
    rounded = identify(y, order=2).plant
    assert noise_of(rounded)[0] >= 0.99 * np.sqrt(1 / 12)
    assert noise_of(rounded)[0] == pytest.approx(np.sqrt(1 / 12), rel=0.35)


def test_tables_give_the_names_and_a_held_out_table_may_have_its_columns_in_another_order() -> None:
    (y, u), (fresh, v) = (engineering(record(KNOWN, N, N)) for N in (400, 300))
    names = ["flow", "level", "heat", "load"]
    held_out = pd.DataFrame(fresh, columns=names)[["load", "heat", "level", "flow"]]
    table, valve = pd.DataFrame(y, columns=names), pd.DataFrame(u, columns=["valve"])
    one = identify(table, valve, order=2, dt=60.0, held_out=held_out, held_out_u=v, name="tank")
    assert (one.plant.channel_names, one.plant.input_names) == (tuple(names), ("valve",))
    assert (one.plant.dt, one.plant.name) == (60.0, "tank")
    plain = identify(y, u, order=2, held_out=fresh, held_out_u=v)
    assert_same_bits(one.plant, plain.plant)
    assert one.verdict.residuals.size == plain.verdict.residuals.size


def test_channels_are_grouped_into_the_sensors_asked_for() -> None:
    names = ["a", "b", "c", "d"]
    grouped = learn(500, channel_names=names, sensors={"head": ["d", "a"]}).plant
    assert grouped.sensor_names == ("head", "b", "c")
    assert grouped.channel_names == ("a", "d", "b", "c")
    assert not np.any(grouped.R - np.diag(np.diag(grouped.R)))
    order = [names.index(channel) for channel in grouped.channel_names]
    alone = learn(500, channel_names=names).plant
    np.testing.assert_array_equal(grouped.C, alone.C[order])


def test_eigenvalues_stay_below_the_largest_asked_for() -> None:
    assert np.max(np.abs(np.linalg.eigvals(learn(500).plant.A))) > 0.9
    limited = learn(500, largest_eigenvalue=0.8).plant
    assert np.max(np.abs(np.linalg.eigvals(limited.A))) <= 0.8 + 1e-9


def closed_loop(N: int = 2000) -> tuple[Array, Array]:
    """A controller that acts at once on the last sensor, which has nothing in common with the others."""
    rng = np.random.default_rng(4)
    x, rows, inputs = np.zeros(2), [], []
    for _ in range(N):
        y = np.array([x[0], x[0], x[1]]) + 0.3 * rng.normal(size=3)
        u = -0.5 * y[2]
        rows.append(y)
        inputs.append([u])
        x = np.array([0.9 * x[0], 0.3 * x[1]]) + rng.normal(size=2) + np.array([0.2 * u, 0.0])
    return np.array(rows), np.array(inputs)


def test_a_sensor_that_only_the_controller_vouches_for_is_named_and_without_feedthrough_not_verifiable() -> (
    None
):
    y, u = closed_loop()
    with pytest.warns(SecurestateWarning, match="Only inputs of the same sample vouch for") as caught:
        leaking = identify(y, u, order=2, feedthrough=True)
    [warning] = [str(one.message) for one in caught]
    assert "y3 (" in warning
    assert "y1" not in warning
    assert "y2" not in warning
    assert leaking.remarks[-1] == warning + "."
    honest = identify(y, u, order=2)
    assert honest.remarks == ()
    assert honest.verdict.verifiable == ("y1", "y2")


def test_honest_feedthrough_is_learned_without_a_warning() -> None:
    through = replace(KNOWN, D=np.array([[0.0], [2.0], [0.0], [-1.0]]))
    y, u = record(through, 1500, 1)
    plant = identify(y, u, order=2, feedthrough=True).plant
    D = plant.scale[:, None] * plant.D / plant.input_scale
    np.testing.assert_allclose(D, through.D, atol=0.1)


def test_a_held_out_record_of_another_place_is_inadequate() -> None:
    y, u = engineering(record(KNOWN, 500, 9))
    slow = np.linalg.solve(np.eye(2) - KNOWN.A, np.array([2.0, 2.0]))
    there = learn(1000, held_out=y + SIZE * (KNOWN.C @ slow), held_out_u=u)
    assert there.verdict.grade is Grade.INADEQUATE
    assert "The plant is elsewhere than where the model was made" in str(there.verdict)
    assert there.noise_factor == 1.0
    here = learn(1000, held_out=y, held_out_u=u)
    assert here.verdict.grade is Grade.GOOD
    assert here.verdict.residuals.samples == 480


def test_noise_is_raised_as_much_as_a_louder_held_out_record_asks_for() -> None:
    y, u = record(replace(KNOWN, Q=1.25 * KNOWN.Q, r=1.25 * KNOWN.r), 4000, 9)
    quiet, louder = learn(1500), learn(1500, held_out=engineering((y, u))[0], held_out_u=50 + 4 * u)
    assert louder.verdict.grade is Grade.USABLE
    assert louder.noise_factor == pytest.approx(louder.verdict.residuals.size)
    assert louder.noise_factor == pytest.approx(1.25, abs=0.05)
    np.testing.assert_allclose(louder.plant.A, quiet.plant.A)
    np.testing.assert_allclose(
        louder.plant.R * quiet.noise_factor, quiet.plant.R * louder.noise_factor, rtol=1e-9
    )


def test_progress_tells_every_stage_and_never_more_than_its_end() -> None:
    told: list[tuple[str, int, int]] = []
    learn(300, progress=lambda *step: told.append(step))
    stages = list(dict.fromkeys(stage for stage, _, _ in told))
    assert stages == ["looking at the past", "order 2", "fitting", "fitting all", "judging"]
    assert all(0 <= done <= total for _, done, total in told)


Y = np.random.default_rng(0).normal(size=(100, 2))


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (
            {"y": Y[:49]},
            MeasurementError,
            "y: expected at least 50 samples for 2 channels and inputs, received 49",
        ),
        (
            {"y": np.random.default_rng(0).normal(size=(60, 30))},
            MeasurementError,
            "y: expected at least 90 samples for 30 channels and inputs, received 60",
        ),
        (
            {"y": np.where(np.arange(100)[:, None] % 9 < [0, 5], NAN, Y)},
            MeasurementError,
            "without a gap of more than 3 samples, received 0; y2 misses most, 56%",
        ),
        ({"y": np.ones((100, 2))}, MeasurementError, "y: expected channels that vary"),
        ({"y": Y, "order": 0}, InputError, "order: expected"),
        ({"y": Y, "order": 1.5}, InputError, "order: expected"),
        ({"y": Y, "order": "best"}, InputError, "order: expected"),
        (
            {"y": Y, "largest_eigenvalue": 1.0},
            InputError,
            "largest_eigenvalue: expected a number in (0, 1), received 1",
        ),
        ({"y": Y, "largest_eigenvalue": -0.5}, InputError, "largest_eigenvalue: expected"),
        (
            {"y": Y, "feedthrough": True},
            InputError,
            "feedthrough: expected inputs, or False, received True without",
        ),
        ({"y": Y, "feedthrough": 1}, InputError, "feedthrough: expected"),
        (
            {"y": Y, "sensors": {"s": ["y9"]}},
            InputError,
            "sensors['s']: expected channels of the history, received 'y9'",
        ),
        (
            {"y": Y, "sensors": {"s": ["y1"], "t": ["y1"]}},
            InputError,
            "sensors: expected every channel in one sensor, received 'y1' in two",
        ),
        ({"y": Y, "u": Y[:50]}, ShapeError, "u: expected 100 samples, as y has, received 50"),
        (
            {"y": Y, "held_out": History.of(Y, channel_names=["y1", "other"])},
            InputError,
            "y: expected a column 'y2', received y1, other",
        ),
        (
            {"y": Y, "dt": 1.0, "held_out": History.of(Y, dt=60.0)},
            InputError,
            "y.dt: expected 1 s between samples, as the plant has, received 60 s",
        ),
    ],
)
def test_a_mistake_names_argument_expected_and_received(
    arguments: dict[str, Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error) as caught:
        identify(**arguments)
    assert message in str(caught.value)

"""The bias monitor: equality with the textbook, false alarms as stated, who is named and by how much."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from securestate import (
    Belief,
    BiasMonitor,
    DesignError,
    InputError,
    KalmanFilter,
    Plant,
    ResumeError,
    Run,
    SecurestateWarning,
    Sensor,
    ShapeError,
    Status,
    simulate,
)
from tests.estimators.run_arrays import RUN_ARRAYS
from tests.reference.bias_monitor import Textbook

Float = NDArray[np.float64]
T = 220


@cache
def mixed(uncheckable: tuple[str, ...] = ()) -> Plant:
    """Inputs, an operating point, a sensor with two channels, noise of all sizes."""
    sensors = [
        Sensor("a", C=[1, 0], R=0.5, D=[0.3]),
        Sensor("b", C=[1, 0.5], R=1, offset=3, scale=2, D=[0.0]),
        Sensor("pair", C=[[0, 1], [1, 1]], R=[1, 0.5], D=[[0.0], [0.1]]),
        Sensor("c", C=[0.5, 1], R=0.7, D=[0.0]),
        Sensor("d", C=[1, -0.5], R=0.7, D=[0.0]),
    ]
    marked = [s.replaced(verifiable=s.name not in uncheckable) for s in sensors]
    return Plant([[0.9, 0.1], [0, 0.8]], 0.2 * np.eye(2), marked, B=[[1.0], [0.5]], input_offset=1.0)


@cache
def monitor() -> BiasMonitor:
    return BiasMonitor(mixed(), run_length=300)


def record(plant: Plant, seed: int = 1, runs: int = 1) -> tuple[Float, Float]:
    u = plant.input_offset + np.random.default_rng(seed).normal(size=(T, 1))
    drawn = simulate(plant, T, seed=seed, u=u, runs=runs)
    return np.array(drawn.y), u


def wide(n: int = 6, m: int = 12) -> Plant:
    rng = np.random.default_rng(4)
    rows = 1.5 * rng.normal(size=(m, n)) / np.sqrt(n)
    sensors = [Sensor(f"s{i}", C=row, R=1.0) for i, row in enumerate(rows)]
    return Plant(np.diag(rng.uniform(0.5, 0.98, n)), 0.3 * np.eye(n), sensors)


def nobody(_: Float) -> None:
    pass


def one(y: Float) -> None:
    y[80:, 1] += 4.0


def two(y: Float) -> None:
    y[60:, 0] += 2.0
    y[120:, 4] -= 2.0


def ending(y: Float) -> None:
    y[40:100, 1] += 4.0


def both_channels(y: Float) -> None:
    y[60:, 2] += 2.0
    y[90:, 3] += 3.0


def growing(y: Float) -> None:
    y[40:, 3] += 0.06 * np.arange(T - 40)


def more_than_can_be_kept(y: Float) -> None:
    for number, channel in enumerate((0, 1, 4, 5, 2, 3)):
        y[20 + 25 * number :, channel] += 8.0 * (-1) ** number


def changing(y: Float) -> None:
    y[40:, 0] += 2.0
    y[110:, 0] += 2.0
    y[180:, 0] -= 6.0


CASES: list[tuple[Callable[[Float], None], float]] = [
    (nobody, 0.08), (one, 0.0), (two, 0.0), (two, 0.08), (ending, 0.0), (ending, 0.08),
    (both_channels, 0.08), (growing, 0.0), (more_than_can_be_kept, 0.08), (changing, 0.0),
]  # fmt: skip


def assert_textbook(estimator: BiasMonitor, y: Float, u: Float) -> Run:
    plant = estimator.plant
    run = estimator.run(y, u)
    book: dict[str, Any] = Textbook(plant, estimator.limit, estimator.gamma).run(
        plant.normalise(y), plant.normalise_input(u)
    )
    assert run.P is not None
    for name, ours in {
        "x": run.x,
        "P": run.P,
        "attack": run.attack / plant.scale,
        "attack_std": run.attack_std / plant.scale,
        "innovation": run.innovation / plant.scale,
        "ratio": run.diagnostics["ratio"],
        "suspected": run.suspected,
        "leader": run.diagnostics["leader"],
        "steps": run.diagnostics["biases"],
    }.items():
        np.testing.assert_allclose(ours, book[name], rtol=1e-8, atol=1e-9, err_msg=name)
    arrived = ~np.isnan(y).all(axis=1)
    np.testing.assert_array_equal(run.status[arrived] == Status.AMBIGUOUS, book["ambiguous"][arrived])
    return run


@pytest.mark.parametrize(("lie", "missing"), CASES)
def test_every_step_is_that_of_the_textbook(lie: Callable[[Float], None], missing: float) -> None:
    y, u = record(mixed())
    y = y[0]
    lie(y)
    y[np.random.default_rng(2).random(y.shape) < missing] = np.nan
    y[[50, 130] if missing else []] = np.nan
    run = assert_textbook(monitor(), y, u)
    assert run.suspected.any() == (lie is not nobody)


def test_with_a_larger_variance_and_sensors_that_nobody_vouches_for_it_is_the_textbook_still() -> None:
    plant = mixed(("c",))
    clean, u = record(plant, 5, runs=12)
    spread = clean.mean() + 1.15 * (clean - clean.mean())
    estimator = BiasMonitor(plant, run_length=300, calibrate_on=[(y, u) for y in spread])
    assert estimator.gamma > 1
    y = record(plant)[0][0]
    two(y)
    y[30:70, 4] += 3.0
    run = assert_textbook(estimator, y, u)
    assert run.suspected.any()


def test_while_nobody_is_suspected_it_is_the_kalman_filter() -> None:
    y, u = record(mixed())
    run, kalman = BiasMonitor(mixed(), run_length=1e6).run(y[0], u), KalmanFilter(mixed()).run(y[0], u)
    assert not run.suspected.any()
    for name in ("x", "x_std", "P", "innovation", "innovation_std"):
        np.testing.assert_allclose(getattr(run, name), getattr(kalman, name), rtol=1e-9, atol=1e-9)


def test_an_innovation_is_what_the_estimate_before_did_not_foresee() -> None:
    plant = mixed()
    y, u = record(plant)
    two(y[0])
    run = monitor().run(y[0], u)
    assert run.suspected.any(axis=0).sum() >= 2
    expected = plant.successor(run.x[:-1], u[:-1])
    np.testing.assert_allclose(run.innovation[1:], y[0, 1:] - plant.reading(expected, u[1:]), atol=1e-9)


def test_batch_equals_loop_and_live_filter_to_the_bit() -> None:
    y, u = record(mixed(), runs=3)
    two(y[1])
    growing(y[2])
    y[0, 20:25, 1] = np.nan
    batch, live = monitor().run(y, u), monitor().start()
    for i in range(3):
        single = monitor().run(y[i], u)
        for name in RUN_ARRAYS:
            np.testing.assert_array_equal(getattr(batch, name)[i], getattr(single, name))
    steps = [live.step(*sample) for sample in zip(y[1], u, strict=True)]
    np.testing.assert_array_equal([step.attack for step in steps], batch.attack[1])


@pytest.mark.parametrize("at", [10, 100, 200])
def test_save_and_resume_continue_to_the_bit(at: int) -> None:
    y, u = record(mixed())
    both_channels(y[0])
    y[0, 95:105, 0] = np.nan
    whole, first = monitor().run(y[0], u), monitor().start()
    first.run(y[0, :at], u[:at])
    rest = monitor().resume(first.save()).run(y[0, at:], u[at:])
    for name in RUN_ARRAYS:
        np.testing.assert_array_equal(getattr(whole, name)[at:], getattr(rest, name))


def test_saved_bytes_belong_to_one_limit_one_plant_and_who_can_be_checked() -> None:
    blob = monitor().start().save()
    for other in (BiasMonitor(mixed(), run_length=2000), BiasMonitor(mixed(("a",)), run_length=300)):
        with pytest.raises(ResumeError):
            other.resume(blob)
    with pytest.raises(ResumeError):
        monitor().resume(blob[:-9])


def episodes(suspected: NDArray[np.bool_]) -> int:
    """Stretches of suspicion with more than 40 quiet samples between them, over all runs."""
    times = [np.flatnonzero(run) for run in suspected.any(axis=-1)]
    return sum(int(np.count_nonzero(np.diff(at, prepend=-100) > 40)) for at in times)


@pytest.mark.parametrize(("n", "m", "run_length"), [(1, 3, 3000.0), (6, 12, 1000.0)])
def test_honest_sensors_raise_as_many_false_alarms_as_stated(n: int, m: int, run_length: float) -> None:
    plant, runs, steps = wide(n, m), 24, int(5 * run_length)
    drawn = simulate(plant, steps, seed=8, runs=runs)
    run = BiasMonitor(plant, run_length=run_length).run(drawn.y, drawn.u, covariance=False)
    # 120 are expected: their number varies by 9 %, the limit they follow from by 12 %.
    assert 0.62 < episodes(run.suspected) * run_length / (runs * steps) < 1.45


def test_a_long_run_length_is_extrapolated() -> None:
    limits = [BiasMonitor(wide(3, 6), run_length=length).limit for length in (1e3, 1e4, 1e5)]
    steps = np.diff(limits)
    assert (steps > 3).all() and (steps < 8).all()  # about 2 ln 10 each


def test_a_bias_of_one_standard_deviation_is_named_and_its_size_is_right() -> None:
    plant, runs, start = wide(), 40, 100
    clean = simulate(plant, 300, seed=3, runs=runs)
    y, liar = np.array(clean.y), np.arange(runs) % plant.m
    for i in range(runs):
        y[i, start:, liar[i]] += 1.0
    run, kalman = BiasMonitor(plant).run(y), KalmanFilter(plant).run(y)
    last = run.suspected[:, -1]
    right = last[np.arange(runs), liar]
    assert right.mean() > 0.95
    assert last.sum() - right.sum() <= 0.1 * runs  # false alarms, and wrong names that fade slowly
    size, std = (array[np.arange(runs), -1, liar][right] for array in (run.attack, run.attack_std))
    assert (np.abs(size - 1.0) < 3 * std).mean() >= 0.95
    off = [np.mean((one.x - clean.x)[:, 200:] ** 2) for one in (run, kalman)]
    assert off[0] < off[1]


def test_the_error_is_as_large_as_p_says_while_a_bias_is_known() -> None:
    plant, runs = wide(3, 6), 200
    clean = simulate(plant, 160, seed=9, runs=runs)
    y = np.array(clean.y)
    y[:, 60:, 2] += 3.0
    run = BiasMonitor(plant).run(y)
    assert run.P is not None
    known = run.suspected[:, -1].tolist()
    errors = (run.x - clean.x)[:, -1]
    P = run.P[:, -1]
    nees = np.einsum("ri,rij,rj->r", errors, np.linalg.inv(P), errors)[np.array(known) @ np.eye(6)[2] > 0]
    assert len(nees) > 190
    assert 0.8 < nees.mean() / plant.n < 1.25


def test_a_bias_that_ends_is_forgotten_and_found_again() -> None:
    plant = wide(3, 6)
    y = np.array(simulate(plant, 700, seed=6).y[0])
    y[100:250, 2] += 3.0
    y[450:600, 2] += 3.0
    run = BiasMonitor(plant, run_length=1e5).run(y)
    assert run.suspected[150:240, 2].all() and run.suspected[500:590, 2].all()
    assert not run.suspected[300:440].any() and not run.suspected[650:].any()
    assert run.diagnostics["biases"][430] == 0


def test_sensors_that_cannot_be_checked_are_never_named() -> None:
    plant = mixed(("b",))
    y, u = record(plant)
    one(y[0])
    y[0, 100:, 1] += 4.0
    run = BiasMonitor(plant, run_length=300).run(y[0], u)
    assert not run.suspected[:, 1].any() and np.isnan(run.trust[:, 1]).all()
    assert (run.status[110:] == Status.AMBIGUOUS).mean() > 0.5
    plain = monitor().run(y[0], u)
    assert plain.suspected[120:, 1].all() and (plain.trust[120:, 1] < 0.5).all()


def test_trust_is_a_share_and_below_one_half_where_a_sensor_is_suspected() -> None:
    y, u = record(mixed())
    two(y[0])
    y[0, 200] = np.nan
    run = monitor().run(y[0], u)
    sent = ~np.isnan(run.trust)
    assert ((run.trust[sent] >= 0) & (run.trust[sent] <= 1)).all()
    assert (run.trust[run.suspected] < 0.5).all()
    assert (run.trust[:50].min(axis=1) > 0.2).all()
    assert run.status[200] == Status.NO_MEASUREMENT and np.isnan(run.trust[200]).all()


def test_the_channel_of_a_sensor_is_found() -> None:
    y, u = record(mixed())
    y[0, 100:, 3] += 3.0
    run = monitor().run(y[0], u)
    assert run.suspected[130:, 2].all()
    assert (run.attack[130:, 2] == 0).all() and (np.abs(run.attack[130:, 3] - 3) < 1).all()
    assert np.isnan(run.attack_std[130:, 2]).all() and (run.attack_std[130:, 3] > 0).all()


def test_gaps_cost_little_and_many_of_them_are_warned_of() -> None:
    plant = wide(3, 6)
    y = np.array(simulate(plant, 400, seed=2).y[0])
    y[100:, 4] += 3.0
    gaps = np.random.default_rng(1).random(y.shape) < 0.09
    y[gaps] = np.nan
    run = BiasMonitor(plant).run(y)
    sent = ~gaps[150:, 4]
    assert run.suspected[150:, 4][sent].all() and not run.suspected[150:, 4][~sent].any()
    assert np.isnan(run.attack[gaps]).all() and abs(run.attack[150:, 4][sent][-1] - 3) < 0.5
    y[::3] = np.nan
    with pytest.warns(SecurestateWarning, match="missing"):
        BiasMonitor(plant).run(y)


@pytest.mark.parametrize("size", [1e6, 1e30, 1e300])
def test_numbers_stay_numbers_whatever_a_sensor_sends(size: float) -> None:
    plant = wide(3, 6)
    y = np.array(simulate(plant, 200, seed=2).y[0])
    y[50:120, 1] = size
    y[80:, 4] = -size
    run = BiasMonitor(plant).run(y)
    for name in ("x", "P", "trust", "attack", "innovation"):
        assert np.isfinite(getattr(run, name)).all(), name
    assert run.suspected[60, 1]


def test_clean_records_of_the_model_itself_change_nothing_and_louder_ones_are_allowed_for() -> None:
    plant = wide(3, 6)
    y = np.array(simulate(plant, 1500, seed=2, runs=4).y)
    assert BiasMonitor(plant, calibrate_on=list(y)).gamma < 1.08
    assert BiasMonitor(plant, calibrate_on=y[0]).gamma < 1.15
    louder = BiasMonitor(plant, calibrate_on=list(np.sqrt(1.4) * y))
    assert 1.25 < louder.gamma < 1.55
    assert louder.limit == BiasMonitor(plant).limit
    with pytest.raises(DesignError, match=r"the model is inadequate.*; identify the plant again"):
        BiasMonitor(plant, calibrate_on=list(2.0 * y))


def test_clean_records_may_begin_anywhere_and_have_gaps() -> None:
    plant, runs = mixed(), 8
    u = plant.input_offset + np.random.default_rng(5).normal(size=(T, 1))
    far = Belief([300.0, -200.0], 0.2 * np.eye(2))
    y = np.array(simulate(plant, T, seed=5, u=u, runs=runs, prior=far).y)
    y[:, 100:110, 2] = np.nan
    assert BiasMonitor(plant, calibrate_on=[(one, u) for one in y]).gamma < 1.2
    assert BiasMonitor(plant, calibrate_on=[(one, u) for one in y[:3]]).gamma < 1.3


@pytest.mark.parametrize(
    ("records", "error", "text"),
    [
        (np.zeros((500, 4)), ShapeError, r"calibrate_on\[0\]: y"),
        (np.zeros((200, 3)), InputError, "calibrate_on: expected at least 10 blocks"),
        ([(np.zeros((500, 3)), np.zeros((500, 1)))], InputError, "calibrate_on"),
        ([np.zeros((500, 3)), "text"], InputError, r"calibrate_on\[1\]: y"),
    ],
)
def test_records_that_do_not_fit_are_refused(records: object, error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        BiasMonitor(wide(1, 3), calibrate_on=records)


def test_a_plant_with_inputs_wants_pairs() -> None:
    with pytest.raises(InputError, match=r"calibrate_on\[0\]: expected \(y, u\) pairs"):
        BiasMonitor(mixed(), calibrate_on=np.zeros((500, 6)))


@pytest.mark.parametrize("value", [0, -1.0, 99, np.nan, np.inf, "long", True, None])
def test_a_run_length_out_of_range_is_refused(value: Any) -> None:
    with pytest.raises(InputError, match="run_length"):
        BiasMonitor(wide(1, 3), run_length=value)


def test_what_it_cannot_do_is_refused_with_advice() -> None:
    sensors = [Sensor(name, C=[1.0], R=1.0) for name in "ab"]
    with pytest.raises(DesignError, match="does not vary in time; use"):
        BiasMonitor(Plant(np.full((5, 1, 1), 0.5), [[1.0]], sensors))
    with pytest.raises(DesignError, match="single sensor"):
        BiasMonitor(Plant([[0.5]], [[1.0]], sensors[:1]))
    with pytest.raises(InputError, match=r"prior\.P"):
        monitor().start(Belief([0.0, 0.0], np.eye(2)))
    with pytest.raises(InputError, match="plant"):
        BiasMonitor("plant.toml")  # type: ignore[arg-type]


def test_settings_say_what_was_chosen_and_designs_repeat_themselves() -> None:
    estimator = BiasMonitor(wide(3, 6), run_length=500)
    assert estimator.settings == {"run_length": 500.0}
    assert estimator.gamma == 1.0
    assert estimator.limit == BiasMonitor(wide(3, 6), run_length=500).limit

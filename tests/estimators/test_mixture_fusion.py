"""Mixture fusion: equality with an independent program and the textbook, its settings, and hard data."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from securestate import (
    Belief,
    ChiSquareFilter,
    DesignError,
    InnovationGate,
    InputError,
    KalmanFilter,
    MixtureFusion,
    OracleFilter,
    Plant,
    ResumeError,
    Run,
    Sensor,
    Status,
)
from tests.estimators.run_arrays import RUN_ARRAYS
from tests.reference import mixture_fusion as book

Array = np.ndarray[Any, np.dtype[np.float64]]

CASE = json.loads((Path(__file__).parents[1] / "cases/mixture/golden.json").read_text())
START = CASE["T0"]

#: The settings of the program's runs.
PAPER: dict[str, dict[str, Any]] = {
    "run_paper_literal_45_split": {"epsilon": 0.45, "literal": True},
    "run_paper_fix_45_split": {"epsilon": 0.45},
    "run_paper_fix_none_median": {"epsilon": None, "init": "median"},
    "run_paper_plus": {
        "epsilon": None,
        "init": "median",
        "mean": "precision",
        "floor": "prior",
        "feedback": True,
    },
}


def numbers(values: Any) -> Array:
    """Infinities are text in the file."""
    return np.array(values, dtype=float)


def golden_plant() -> Plant:
    A, Q, C, R = (CASE["system"][name] for name in "AQCR")
    sensors = [Sensor(f"s{i}", C=[c], R=r) for i, (c, r) in enumerate(zip(C, R, strict=True))]
    return Plant([A], [Q], sensors)


def random_plant(seed: int, n: int, *, sensors: int = 6, inputs: int = 2) -> Plant:
    """Every sensor sees the whole state, by one to three channels with noise correlated among themselves."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
    root = rng.normal(size=(n, n))
    made = []
    for i in range(sensors):
        m = 1 + i % 3
        noise = rng.normal(size=(m, m))
        D = rng.normal(size=(m, inputs)) if inputs else None
        made.append(
            Sensor(f"s{i}", C=rng.normal(size=(m, n)), R=noise @ noise.T + 0.3 * np.eye(m), D=D, scale=2.0)
        )
    B = rng.normal(size=(n, inputs)) if inputs else None
    return Plant(A, 0.2 * root @ root.T + 0.1 * np.eye(n), made, B=B)


def root(cov: Array) -> Array:
    """M with M' M = cov."""
    _, values, Vh = np.linalg.svd(cov)
    return np.asarray(np.sqrt(values)[:, None] * Vh)


def attacked_data(plant: Plant, T: int, seed: int, *, missing: float = 0.0) -> tuple[Array, Array]:
    """Readings in sensor units, of which some sensors' are far off now and then, and inputs."""
    rng = np.random.default_rng(seed)
    u = rng.normal(size=(T, plant.n_inputs))
    x, y, v, w = np.zeros(plant.n), np.empty((T, plant.m)), root(plant.R), root(plant.Q)
    for k in range(T):
        y[k] = plant.C @ x + plant.D @ u[k] + rng.standard_normal(plant.m) @ v
        x = plant.A @ x + plant.B @ u[k] + rng.standard_normal(plant.n) @ w
    lies = (rng.random((T, plant.n_sensors)) < 0.2)[:, plant.channel_sensor]
    y = np.where(lies, y + rng.normal(scale=10, size=y.shape), y)
    y[rng.random(y.shape) < missing] = np.nan
    return y * plant.scale + plant.offset, u


def textbook(plant: Plant, y: Array, u: Array, prior: Belief, **settings: Any) -> book.Textbook:
    assert prior.P is not None
    return book.mixture_fusion(plant, (y - plant.offset) / plant.scale, u, prior.x, prior.P, **settings)


def assert_equals_textbook(run: Run, expected: book.Textbook, tolerance: float = 1e-8) -> None:
    size = np.abs(expected.x).max()
    np.testing.assert_allclose(run.x, expected.x, rtol=0, atol=tolerance * size)
    np.testing.assert_allclose(run.P, expected.P, rtol=0, atol=tolerance * np.abs(expected.P).max())
    np.testing.assert_allclose(run.trust, expected.trust, rtol=0, atol=tolerance)
    np.testing.assert_array_equal(run.suspected, expected.trust < 0.5)
    attack = expected.attack * run.plant.scale
    np.testing.assert_allclose(run.attack, attack, rtol=0, atol=tolerance * np.nanmax(np.abs(attack)))
    for name, values in expected.diagnostics.items():
        np.testing.assert_allclose(run.diagnostics[name], values, rtol=1e-6, atol=1e-6, err_msg=name)


# ---------------------------------------------------------------- an independent program


@pytest.mark.parametrize("name", PAPER)
def test_every_step_is_that_of_an_independent_program(name: str) -> None:
    golden = CASE[name]
    run = MixtureFusion(golden_plant(), start=START, **PAPER[name]).run(numbers(CASE["y"]))
    assert run.P is not None
    np.testing.assert_allclose(run.x[:, 0], numbers(golden["xhat"]), rtol=0, atol=1e-8)
    np.testing.assert_allclose(run.P[:, 0, 0], numbers(golden["P"]), rtol=0, atol=1e-8)
    np.testing.assert_allclose(run.trust[START:], numbers(golden["gamma"]), rtol=0, atol=1e-8)
    assert not run.suspected[:START].any()


@pytest.mark.parametrize("name", ["oracle", "plain", "chi2dist", "chi2central", "gate"])
def test_the_baselines_are_those_of_the_same_program(name: str) -> None:
    plant, y, golden = golden_plant(), numbers(CASE["y"]), CASE[f"run_{name}"]
    before = KalmanFilter(plant).run(y[:START])
    assert before.P is not None
    belief = Belief(plant.A @ before.x[-1], plant.A @ before.P[-1] @ plant.A.T + plant.Q)
    late = slice(START, None)
    if name == "oracle":
        run = OracleFilter(plant).run(
            y[late], prior=belief, attacked=np.array(CASE["mask"][START:], dtype=bool)
        )
    elif name == "plain":
        run = KalmanFilter(plant).run(y[late], prior=belief)
    elif name == "gate":
        run = InnovationGate(plant).run(y[late], prior=belief)
    elif name == "chi2central":
        run = ChiSquareFilter(plant, scope="central").run(y[late], prior=belief)
    else:  # its own filters must hear the first samples; two false alarms there are forgotten soon
        run, late = ChiSquareFilter(plant).run(y), slice(START + 5, None)
    assert run.P is not None
    end = len(y) - late.start
    np.testing.assert_allclose(run.x[-end:, 0], numbers(golden["xhat"])[late], rtol=0, atol=1e-8)
    np.testing.assert_allclose(run.P[-end:, 0, 0], numbers(golden["P"])[late], rtol=0, atol=1e-8)
    gamma = np.broadcast_to(numbers(golden["gamma"]), (10, 7))[-end:]
    np.testing.assert_array_equal(run.trust[-end:], gamma)


# ---------------------------------------------------------------- the textbook

SETTINGS: list[dict[str, Any]] = [
    {},
    {"epsilon": None, "init": "median", "mean": "precision"},
    {"epsilon": 0.3, "init": "prediction", "floor": "prior"},
    {"epsilon": 0.6, "init": "mean", "mean": "precision", "floor": "prior", "start": 7, "cap": 9},
    {"feedback": True, "init": "median", "mean": "precision", "floor": "prior"},
]


@pytest.mark.parametrize("missing", [0.0, 0.25])
@pytest.mark.parametrize("settings", SETTINGS)
@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_vector_sensors_with_inputs_and_gaps_equal_the_textbook(
    n: int, settings: dict[str, Any], missing: float
) -> None:
    plant, prior = random_plant(n, n), Belief(np.arange(n, dtype=float), 3 * np.eye(n))
    y, u = attacked_data(plant, 40, n, missing=missing)
    run = MixtureFusion(plant, **settings).run(y, u, prior)
    assert_equals_textbook(run, textbook(plant, y, u, prior, **settings))
    assert run.suspected.any() and not run.suspected.all()


@pytest.mark.parametrize("n", [1, 3])
def test_the_literal_form_equals_the_textbook_until_it_explodes(n: int) -> None:
    plant, prior = random_plant(n, n), Belief(np.zeros(n), np.eye(n))
    y, u = attacked_data(plant, 6, n)
    run = MixtureFusion(plant, literal=True).run(y, u, prior)
    assert_equals_textbook(run, textbook(plant, y, u, prior, literal=True), 1e-6)
    assert run.diagnostics["swapped"].any()


# ---------------------------------------------------------------- the mixture


def eight_sensors() -> Plant:
    return Plant([[0.5]], [[1.0]], [Sensor(f"s{i}", C=[1.0], R=1.0 + 2 * i) for i in range(8)])


def test_the_likelihood_rises_with_the_precise_mean_and_not_always_with_that_of_the_paper() -> None:
    rng = np.random.default_rng(3)
    y = rng.normal(scale=2, size=(60, 8))
    y[:, ::4] += rng.normal(scale=8, size=(60, 2))
    for mean, low, high in (("precision", 0.0, 1e-8), ("printed", 1e-3, 1.0)):
        # the sensors' own estimates, and with them the mixtures, do not depend on the cap
        each = [
            MixtureFusion(eight_sensors(), mean=mean, init="median", cap=cap).run(y) for cap in range(1, 60)
        ]  # type: ignore[arg-type]
        falls = -np.diff([run.diagnostics["log_likelihood"] for run in each], axis=0)
        assert low <= falls.max() < high, mean
        if mean == "printed":
            assert (falls.max(axis=0) > 1e-6).mean() > 0.1


def test_the_iteration_stops_at_its_cap_and_says_so() -> None:
    y = np.random.default_rng(0).normal(size=(30, 8))
    capped, free, one = (
        MixtureFusion(eight_sensors(), cap=cap).run(y, covariance=False) for cap in (3, 5000, 1)
    )
    late = capped.diagnostics["gap"] >= 1e-6
    assert late.any() and (capped.diagnostics["iterations"][late] == 3).all()
    assert (capped.status[late & ~majority(capped)] == Status.NOT_CONVERGED).all()
    assert (free.diagnostics["gap"] < 1e-6).all() and (free.diagnostics["iterations"] < 5000).all()
    assert not (free.status == Status.NOT_CONVERGED).any()
    assert (one.diagnostics["gap"] == np.inf).all()


def majority(run: Run) -> Any:
    return 2 * run.suspected.sum(axis=-1) > (~np.isnan(run.trust)).sum(axis=-1)


def test_the_status_says_when_a_majority_is_suspected() -> None:
    plant = random_plant(1, 2)
    y, u = attacked_data(plant, 200, 1, missing=0.1)
    run = MixtureFusion(plant, epsilon=None).run(y, u)
    assert majority(run).any()
    np.testing.assert_array_equal(run.status == Status.MAJORITY_SUSPECT, majority(run))


def test_the_compensator_swaps_where_the_mean_belief_in_an_attack_is_above_epsilon() -> None:
    plant = random_plant(2, 2)
    y, u = attacked_data(plant, 200, 2)
    plain = MixtureFusion(plant, epsilon=None).run(y, u)
    assert not plain.diagnostics["swapped"].any()
    np.testing.assert_allclose(plain.diagnostics["mean_attacked"], 1 - plain.trust.mean(axis=-1), atol=1e-12)
    for epsilon in (0.0, 0.3, 0.5, 1.0):
        run = MixtureFusion(plant, epsilon=epsilon).run(y, u)
        swapped = plain.diagnostics["mean_attacked"] > epsilon
        np.testing.assert_array_equal(run.diagnostics["swapped"], swapped)
        expected = np.where(swapped[:, None], 1 - plain.trust, plain.trust)
        np.testing.assert_allclose(run.trust, expected, rtol=0, atol=1e-12)


# ---------------------------------------------------------------- what else a run promises


@pytest.mark.parametrize("settings", [{}, {"feedback": True}, {"literal": True}])
def test_before_the_start_it_is_the_kalman_filter_to_the_bit(settings: dict[str, Any]) -> None:
    plant = random_plant(3, 3)
    y, u = attacked_data(plant, 120, 3, missing=0.05)
    run, kalman = MixtureFusion(plant, start=100, **settings).run(y, u), KalmanFilter(plant).run(y, u)
    for quantity in ("x", "x_std", "P", "trust", "innovation", "innovation_std", "status"):
        np.testing.assert_array_equal(getattr(run, quantity)[:100], getattr(kalman, quantity)[:100])
    np.testing.assert_array_equal(run.attack[:100], np.where(np.isnan(y[:100]), np.nan, 0.0))
    assert run.suspected[100:].any()


def test_one_sensor_alone_is_believed_and_one_that_sends_nothing_has_no_trust() -> None:
    plant = random_plant(4, 2, sensors=4)
    y, u = attacked_data(plant, 60, 4)
    alone, silent = y.copy(), y.copy()
    alone[20, plant.channel_sensor != 1] = np.nan
    silent[20:40, plant.channel_sensor == 2] = np.nan
    run = MixtureFusion(plant).run(alone, u)
    np.testing.assert_array_equal(run.trust[20], [np.nan, 1.0, np.nan, np.nan])
    assert np.isnan(run.diagnostics["log_likelihood"][20]) and run.diagnostics["iterations"][20] == 0
    run = MixtureFusion(plant).run(silent, u)
    assert np.isnan(run.trust[20:40, 2]).all() and not np.isnan(np.delete(run.trust, 2, axis=1)).any()
    assert not run.suspected[20:40, 2].any()
    assert np.isnan(run.attack[20:40][:, plant.channel_sensor == 2]).all()


def test_a_sample_without_anything_is_a_prediction() -> None:
    plant = random_plant(5, 2)
    y, u = attacked_data(plant, 30, 5)
    y[10] = np.nan
    run = MixtureFusion(plant).run(y, u)
    assert run.status[10] == Status.NO_MEASUREMENT and np.isnan(run.trust[10]).all()
    np.testing.assert_allclose(run.x[10], plant.A @ run.x[9] + plant.B @ u[9])


def test_an_attack_is_what_is_left_of_the_reading() -> None:
    plant = random_plant(6, 2)
    y, u = attacked_data(plant, 80, 6, missing=0.1)
    run = MixtureFusion(plant).run(y, u)
    rest = y - plant.reading(run.x, u)
    lies = run.suspected[:, plant.channel_sensor]
    expected = np.where(np.isnan(y), np.nan, np.where(lies, rest, 0.0))
    np.testing.assert_allclose(run.attack, expected, atol=1e-10)
    assert np.isnan(run.attack_std).all()


ALL_SETTINGS = [*SETTINGS, {"literal": True, "epsilon": 0.45}, {"literal": True, "feedback": True}]


@pytest.mark.parametrize("settings", ALL_SETTINGS)
def test_save_and_resume_continue_to_the_bit(settings: dict[str, Any]) -> None:
    plant = random_plant(7, 3)
    y, u = attacked_data(plant, 90, 7, missing=0.1)
    y[:30] = attacked_data(plant, 30, 8)[0]
    estimator = MixtureFusion(plant, **settings)
    whole, live, parts = estimator.run(y, u), estimator.start(), []
    for k in range(90):
        parts.append(live.step(y[k], u[k]))
        if k % 7 == 0:
            live = estimator.resume(live.save())
    for quantity in RUN_ARRAYS:
        np.testing.assert_array_equal([getattr(e, quantity) for e in parts], getattr(whole, quantity))
    for name, values in whole.diagnostics.items():
        np.testing.assert_array_equal([e.diagnostics[name] for e in parts], values)


@pytest.mark.parametrize("settings", ALL_SETTINGS)
def test_batch_equals_loop_to_the_bit(settings: dict[str, Any]) -> None:
    plant = random_plant(8, 2)
    estimator = MixtureFusion(plant, **settings)
    y = np.stack([attacked_data(plant, 300, seed, missing=0.1 * (seed % 2))[0] for seed in range(3)])
    u = attacked_data(plant, 300, 0)[1]
    batch = estimator.run(y, u)
    for r in range(3):
        single = estimator.run(y[r], u)
        for quantity in RUN_ARRAYS:
            np.testing.assert_array_equal(getattr(batch, quantity)[r], getattr(single, quantity))
        for name, values in batch.diagnostics.items():
            np.testing.assert_array_equal(values[r], single.diagnostics[name])


def test_a_state_of_other_settings_is_refused() -> None:
    plant = random_plant(9, 2)
    changes: list[dict[str, Any]] = [
        {},
        {"epsilon": None},
        {"epsilon": 0.4},
        {"init": "median"},
        {"literal": True},
        {"start": 3},
        {"mean": "precision"},
        {"floor": "prior"},
        {"feedback": True},
        {"cap": 50},
    ]
    designs = [MixtureFusion(plant, **settings) for settings in changes]
    blobs = [design.start().save() for design in designs]
    for i, design in enumerate(designs):
        for j, blob in enumerate(blobs):
            if i == j:
                design.resume(blob)
            else:
                with pytest.raises(ResumeError, match="another"):
                    design.resume(blob)


# ---------------------------------------------------------------- hard data


def hostile_plant(seed: int) -> Plant:
    """Sensors over twelve decades of noise, two of them the same."""
    rng = np.random.default_rng(seed)
    n = 1 + seed % 4
    A = np.diag(rng.uniform(0.2, 0.999, n)) + np.triu(rng.normal(size=(n, n)), 1)
    sensors = [
        Sensor(f"s{i}", C=rng.normal(size=(1 + i % 2, n)), R=np.full(1 + i % 2, 10.0 ** (2 * i - 6)))
        for i in range(6)
    ]
    twin = Sensor("twin", C=sensors[2].C, R=np.full(1, 10.0**-2))
    return Plant(A, np.eye(n), [*sensors, twin])


def hostile_data(plant: Plant, T: int, seed: int) -> Array:
    """Sane readings, single ones and whole samples up to 1e300, zeros and gaps."""
    rng = np.random.default_rng(seed)
    y = rng.normal(size=(T, plant.m)) * 10.0 ** rng.uniform(-3, 3, size=(T, 1))
    wild = (rng.random(y.shape) < 0.05) | (rng.random((T, 1)) < 0.05)
    y[wild] = rng.choice([-1.0, 1.0], wild.sum()) * 10.0 ** rng.uniform(0, 300, wild.sum())
    y[rng.random(T) < 0.05] = 0.0
    y[(rng.random(y.shape) < 0.1) | (rng.random((T, 1)) < 0.05)] = np.nan
    return y


@pytest.mark.parametrize("settings", ALL_SETTINGS)
def test_no_reading_leads_to_nan_or_an_exception(settings: dict[str, Any]) -> None:
    for seed in range(8):
        plant = hostile_plant(seed)
        y = hostile_data(plant, 2000, seed)
        run = MixtureFusion(plant, **settings).run(y)
        assert np.isfinite(run.x).all() and np.isfinite(run.x_std).all()
        assert run.P is not None and np.isfinite(run.P).all()
        starts = np.searchsorted(plant.channel_sensor, np.arange(plant.n_sensors))
        sent = np.logical_or.reduceat(~np.isnan(y), starts, axis=-1)
        assert np.isnan(run.trust[~sent]).all()
        assert ((run.trust[sent] >= 0) & (run.trust[sent] <= 1)).all()
        assert not np.isnan(run.attack[~np.isnan(y)]).any()


@pytest.mark.parametrize("settings", ALL_SETTINGS)
def test_a_sensor_of_an_unstable_plant_may_be_silent_for_long(settings: dict[str, Any]) -> None:
    sensors = [Sensor(f"s{i}", C=[1.0], R=1.0) for i in range(4)]
    plant = Plant([[1.3]], [[1.0]], sensors, B=[[1.0]])
    rng, T = np.random.default_rng(0), 3000
    x, y, u = 0.0, np.empty((T, 4)), np.empty((T, 1))
    for k in range(T):
        y[k], u[k] = x + rng.normal(size=4), -1.2 * x
        x = 1.3 * x + float(u[k, 0]) + rng.normal()
    y[10:2900, 0] = np.nan  # its own filter alone would predict 1.3 ** 2890
    run = MixtureFusion(plant, **settings).run(y, u)
    assert np.isfinite(run.x).all() and not np.isnan(run.trust[2900:]).any()


def test_the_literal_form_explodes_and_comes_back() -> None:
    plant = golden_plant()
    y = np.random.default_rng(0).normal(size=(3000, 7))
    run = MixtureFusion(plant, literal=True).run(y)
    assert np.isfinite(run.x).all() and np.abs(run.x).max() > 1e20
    broken = run.status == Status.BROKEN_DOWN
    assert (np.abs(run.x[broken]) < 1e100).all()


def test_sensors_that_say_the_same_are_believed() -> None:
    plant = Plant([[0.9]], [[1.0]], [Sensor(f"s{i}", C=[1.0], R=1.0) for i in range(4)])
    run = MixtureFusion(plant, epsilon=None, init="mean").run(np.tile([[0.4]], (5, 4)))
    assert np.isfinite(run.x).all() and not np.isnan(run.trust).any()


# ---------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"epsilon": 1.2}, r"epsilon: expected a number in \[0, 1\], or None, received 1.2"),
        ({"epsilon": "half"}, "epsilon: expected"),
        ({"epsilon": True}, "epsilon: expected"),
        ({"epsilon": float("nan")}, "epsilon: expected"),
        (
            {"init": "kmeans"},
            'init: expected "split" or "median" or "mean" or "prediction", received \'kmeans\'',
        ),
        ({"mean": 1}, 'mean: expected "printed" or "precision"'),
        ({"floor": "none"}, 'floor: expected "printed" or "prior"'),
        ({"literal": 1}, "literal: expected True or False"),
        ({"feedback": "yes"}, "feedback: expected True or False"),
        ({"start": -1}, "start: expected a whole number >= 0"),
        ({"cap": 0}, "cap: expected a whole number >= 1"),
    ],
)
def test_bad_settings_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        MixtureFusion(golden_plant(), **settings)


def test_plants_that_the_method_cannot_take_are_refused_with_the_reason() -> None:
    with pytest.raises(InputError, match="plant: expected a Plant"):
        MixtureFusion("plant.toml")  # type: ignore[arg-type]
    varied = Plant(np.ones((3, 1, 1)), [[1.0]], [Sensor("a", C=[1.0], R=1.0)])
    with pytest.raises(DesignError, match="mixture fusion needs a time-invariant plant"):
        MixtureFusion(varied)
    with pytest.raises(DesignError, match="mixture fusion needs a time-invariant plant"):
        MixtureFusion(varied, feedback=True)
    pair = [Sensor("a", C=[1.0]), Sensor("b", C=[1.0])]
    with pytest.raises(DesignError, match="noise of the sensors 'a' and 'b' is correlated"):
        MixtureFusion(Plant([[0.5]], [[1.0]], pair, R=[[1.0, 0.2], [0.2, 1.0]]))


@pytest.mark.filterwarnings("ignore::securestate.InsecureWarning")
def test_a_sensor_that_sees_too_little_is_named_and_feedback_does_without() -> None:
    axes = [Sensor("east", C=[1.0, 0.0], R=1.0), Sensor("north", C=[0.0, 1.0], R=1.0)]
    plant = Plant(np.eye(2), np.eye(2), axes)
    with pytest.raises(DesignError, match=r"sensor 'east' alone cannot.*InnovationMixture"):
        MixtureFusion(plant)
    assert MixtureFusion(plant, feedback=True).run([[0.1, 0.2]]).x.shape == (1, 2)


def test_without_a_steady_state_a_prior_is_asked_for() -> None:
    plant = Plant([[1.0]], [[0.0]], [Sensor(name, C=[1.0], R=1.0) for name in "abc"])
    estimator = MixtureFusion(plant, feedback=True)
    with pytest.raises(InputError, match="prior: expected a belief with a covariance P"):
        estimator.run([[0.0, 0.1, 0.2]])
    run = estimator.run([[0.0, 0.1, 9.0]], prior=Belief([0.0], [[1.0]]))
    assert run.suspected[0].tolist() == [False, False, True]


def test_settings_say_what_was_chosen() -> None:
    assert MixtureFusion(golden_plant(), epsilon="none").settings["epsilon"] is None
    assert MixtureFusion(golden_plant()).settings == {
        "epsilon": 0.5,
        "init": "split",
        "literal": False,
        "start": 0,
        "mean": "printed",
        "floor": "printed",
        "feedback": False,
        "cap": 100,
    }

"""JointFusion against golden numbers of the paper's example and against the textbook."""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from securestate import Belief, JointFusion, KalmanFilter, Plant, Sensor
from tests.estimators.joint_cases import (
    PAPER_PAIRS,
    PAPER_PRIOR,
    Array,
    assert_close,
    assert_equals_textbook,
    paper_plant,
    random_data,
    random_plant,
    some_prior,
    textbook,
    varying_plant,
)

CASES = Path(__file__).parents[1] / "cases/joint-fusion"
GOLDEN = json.loads((CASES / "paper.json").read_text())


@pytest.mark.parametrize("form", ["exact", "printed"])
def test_golden_gains_and_moments_of_the_papers_example(form: Any) -> None:
    moments = JointFusion(paper_plant(), form=form, pairing=PAPER_PAIRS).moments(1000, PAPER_PRIOR)
    assert not moments.broken.any()
    for k, golden in GOLDEN[form].items():
        now = int(k) - 1
        for i in range(2):
            assert_close(moments.K[i][now], np.array(golden[f"K{i + 1}"]), 1e-8)
            assert_close(moments.Gamma[i][now], np.array(golden[f"Gamma{i + 1}"]), 1e-8)
        Sigma = moments.Sigma[now]
        assert_close(Sigma, np.array(golden["Sigma"]), 1e-8)
        assert_close(moments.G[now], np.array(golden["G"]), 1e-8)
        blocks = [Sigma[:4, :4], Sigma[4:, 4:], Sigma[:4, 4:], moments.P0[now]]
        traces = [golden[name] for name in ("trP1", "trP2", "trP12", "trP0")]
        np.testing.assert_allclose([np.trace(block) for block in blocks], traces, rtol=1e-8)


@pytest.mark.parametrize("form", ["exact", "printed"])
def test_golden_run_of_the_papers_example(form: Any) -> None:
    with (CASES / "trace.csv").open() as file:
        rows = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)][1:]

    def columns(*names: str) -> Array:
        return np.array([[row[name] for name in names] for row in rows])

    y = columns(*(f"y{i}" for i in range(1, 6)))
    run = JointFusion(paper_plant(), form=form, pairing=PAPER_PAIRS).run(y, prior=PAPER_PRIOR)
    fused = columns(*(f"{form}_fus_{i}" for i in range(1, 5)))
    np.testing.assert_allclose(run.x, fused, atol=1e-10)
    np.testing.assert_allclose(run.attack[:, :2], columns(f"{form}_X1_5", f"{form}_X2_5"), atol=1e-10)


FORMS: list[dict[str, Any]] = [{"form": "exact"}, {"square_root": True}, {"form": "printed"}]


@pytest.mark.parametrize("missing", [0.0, 0.3])
@pytest.mark.parametrize("settings", FORMS, ids=["exact", "square-root", "printed"])
@pytest.mark.parametrize("seed", range(3))
def test_vector_sensors_with_inputs_and_correlated_noise_equal_the_textbook(
    seed: int, settings: dict[str, Any], missing: float
) -> None:
    printed = settings.get("form") == "printed"
    plant, eta = random_plant(seed), np.array([0.4, 2.0])
    T = 12 if printed and missing else 60  # the printed moments are none any more after a while
    (y, u), prior = random_data(plant, T, seed, missing=missing), some_prior(plant)
    fusion = JointFusion(plant, eta=eta, **settings)
    run, book = fusion.run(y, u, prior), textbook(fusion, y, u, prior, eta, printed=printed)
    sound = run.status != 4
    assert sound.all() or (printed and missing)
    assert_equals_textbook(fusion, run, book)
    moments = fusion.moments(T, prior, missing=np.isnan(y))
    for name in ("K", "Gamma", "P_X", "U", "V"):
        for got, expected in zip(getattr(moments, name), getattr(book, name), strict=True):
            assert_close(got, expected, 1e-8)
    for name in ("Sigma", "G", "P0"):
        assert_close(getattr(moments, name), getattr(book, name), 1e-8)


@pytest.mark.parametrize("square_root", [False, True])
def test_a_plant_and_an_eta_that_vary_equal_the_textbook(square_root: bool) -> None:
    T = 50
    plant, eta = varying_plant(5, T), 10.0 ** np.random.default_rng(5).uniform(-2, 2, size=(T, 2))
    (y, u), prior = random_data(plant, T, 5, missing=0.2), some_prior(plant)
    fusion = JointFusion(plant, eta=eta, square_root=square_root)
    run, book = fusion.run(y, u, prior), textbook(fusion, y, u, prior, eta)
    assert_equals_textbook(fusion, run, book)


@pytest.mark.parametrize("square_root", [False, True])
def test_engineering_units_change_nothing_but_the_numbers_of_the_file(square_root: bool) -> None:
    plain, rng = random_plant(6), np.random.default_rng(6)
    offset, scale = 100 * rng.normal(size=6), rng.uniform(0.1, 50, size=6)
    sensors = [
        Sensor(s.name, C=s.C, offset=offset[own], scale=scale[own], protected=s.protected)
        for s, own in ((s, plain.channels_of(i)) for i, s in enumerate(plain.sensors))
    ]
    filed = Plant(
        plain.A, plain.Q, sensors, B=plain.B, D=plain.D, R=plain.R, input_offset=[5, -3], input_scale=[2, 0.5]
    )
    (y, u), prior, eta = random_data(plain, 60, 6, missing=0.1), some_prior(plain), {"s0": 30.0, "s1": 4.0}
    y, u = filed.denormalise(y), np.array([5.0, -3.0]) + u * np.array([2.0, 0.5])
    fusion = JointFusion(filed, eta=eta, square_root=square_root)
    book = textbook(fusion, y, u, prior, np.array([30.0, 4.0]))
    assert_equals_textbook(fusion, fusion.run(y, u, prior), book)


def test_a_pairing_hears_only_who_is_in_it() -> None:
    plant, pairing = random_plant(7), {"s1": ["s3"]}
    (y, u), prior = random_data(plant, 40, 7, missing=0.1), some_prior(plant)
    fusion = JointFusion(plant, pairing=pairing)
    assert fusion.locals[0].stack == ([2], [5])
    run = fusion.run(y, u, prior)
    assert_equals_textbook(fusion, run, textbook(fusion, y, u, prior, np.array([1.0])))
    other = y.copy()
    other[:, [0, 1, 3, 4]] = 77.0
    np.testing.assert_array_equal(fusion.run(other, u, prior).x, run.x)


def test_a_steady_start_equals_the_limit_of_a_long_run() -> None:
    for settings in FORMS:
        plant = random_plant(8)
        fusion = JointFusion(plant, eta=5.0, **settings)
        assert fusion.no_steady_state == ""
        y, u = random_data(plant, 1000, 8)
        steady, long = fusion.run(y, u), fusion.run(y, u, some_prior(plant))
        assert steady.P is not None and long.P is not None
        assert_close(long.P[-1], steady.P[0], 1e-12)
        assert_close(long.x[-1], steady.x[-1], 1e-10)
        assert np.array_equal(steady.P[0], steady.P[-1])


def test_one_sensor_that_cannot_inject_is_the_kalman_filter() -> None:
    plant = random_plant(9).select([1, 2, 3])
    (y, u), prior = random_data(plant, 80, 9, missing=0.2), some_prior(plant)
    kalman = KalmanFilter(plant).run(y, u, prior)
    for settings in FORMS:
        run = JointFusion(plant, eta=0.0, **settings).run(y, u, prior)
        assert run.P is not None and kalman.P is not None
        assert_close(run.x, kalman.x, 1e-12)
        assert_close(run.P, kalman.P, 1e-12)
        assert_close(run.attack[:, 0], np.where(np.isnan(y[:, 0]), np.nan, 0.0), 0.0)


def test_the_prior_is_the_estimate_while_nothing_arrives() -> None:
    plant = paper_plant()
    run = JointFusion(plant, pairing=PAPER_PAIRS).run(
        np.full((1, 5), np.nan), prior=Belief(np.ones(4), np.eye(4))
    )
    np.testing.assert_array_equal(run.x[0], np.ones(4))

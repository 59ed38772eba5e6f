"""What JointFusion chooses from the data: eta from the innovations, and who counts as protected."""

from typing import Any

import numpy as np
import pytest

from securestate import InnovationGate, JointFusion, KalmanFilter, Plant, Sensor
from securestate.estimators import Status
from tests.estimators.joint_cases import (
    PAPER_A,
    PAPER_C,
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
from tests.reference.joint_fusion import Adaptive, joint_fusion

LIARS = pytest.mark.parametrize("square_root", [False, True], ids=["joseph", "square-root"])


@LIARS
@pytest.mark.parametrize(("window", "gate"), [(20, 9.0), (3, 2.0), (7, np.inf)])
@pytest.mark.parametrize("seed", range(3))
def test_an_adaptive_eta_equals_the_textbook(seed: int, window: int, gate: float, square_root: bool) -> None:
    plant = random_plant(seed)
    # The paper's variables of the textbook lose about a digit in ten samples, those of the kernels do not.
    (y, u), prior = random_data(plant, 50, seed, missing=0.2), some_prior(plant)
    y[20:35, 0] += 20.0
    fusion = JointFusion(plant, eta="adaptive", window=window, gate=gate, square_root=square_root)
    book = textbook(fusion, y, u, prior, Adaptive(window, gate))
    assert_equals_textbook(fusion, fusion.run(y, u, prior), book)
    assert book.eta.max() > 100 and (book.eta == 0).any()


def test_an_adaptive_eta_on_a_varying_plant_in_engineering_units_equals_the_textbook() -> None:
    plain = varying_plant(2, 40)
    scale = np.random.default_rng(2).uniform(0.1, 50, size=6)
    sensors = [
        Sensor(s.name, C=s.C, scale=scale[plain.channels_of(i)], offset=7.0, protected=s.protected)
        for i, s in enumerate(plain.sensors)
    ]
    plant = Plant(plain.A, plain.Q, sensors, B=plain.B, D=plain.D, R=plain.R)
    (y, u), prior = random_data(plain, 40, 2, missing=0.1), some_prior(plain)
    fusion = JointFusion(plant, eta="adaptive")
    y = plant.denormalise(y)
    assert_equals_textbook(fusion, fusion.run(y, u, prior), textbook(fusion, y, u, prior, Adaptive(20, 9.0)))


def paper_scenario(runs: int, T: int) -> tuple[Array, Array]:
    """States and readings of the paper's example, its attack included, from x[0] ~ PAPER_PRIOR."""
    rng, plant = np.random.default_rng(5), paper_plant()
    x, y = np.empty((runs, T, 4)), np.empty((runs, T, 5))
    now = rng.multivariate_normal(np.zeros(4), PAPER_PRIOR.P, runs)
    for k in range(T):
        x[:, k] = now
        y[:, k] = now @ PAPER_C.T + np.sqrt(0.1) * rng.normal(size=(runs, 5))
        now = now @ PAPER_A.T + rng.multivariate_normal(np.zeros(4), plant.Q, runs)
    y[:, :, 0] += np.sqrt(5) * rng.normal(size=(runs, T))
    y[:, 49, 1] += 3.0
    return x, y


def test_on_the_papers_scenario_an_adaptive_eta_beats_what_protected_sensors_alone_give() -> None:
    x, y = paper_scenario(500, 100)
    fusion = JointFusion(paper_plant(), eta="adaptive", pairing=PAPER_PAIRS)
    run = fusion.run(y, prior=PAPER_PRIOR)
    assert run.P is not None
    error = run.x - x
    assert (error**2).sum(axis=2).mean() < 0.385
    nees = np.einsum("rti,rti->rt", error, np.linalg.solve(run.P, error[..., None])[..., 0])
    assert 0.9 < nees.mean() / 4 < 1.1
    fixed = JointFusion(paper_plant(), pairing=PAPER_PAIRS).run(y, prior=PAPER_PRIOR, covariance=False)
    assert 0.40 < ((fixed.x - x) ** 2).sum(axis=2).mean() < 0.43


@LIARS
def test_an_outlier_of_any_size_has_no_weight_with_an_adaptive_eta(square_root: bool) -> None:
    plant = paper_plant()
    y, _ = random_data(plant, 60, 3)
    fusion = JointFusion(plant, eta="adaptive", square_root=square_root)
    runs = []
    for size in (1e8, 1e20, 1e100, 1e300):
        wild = y.copy()
        wild[30, 0] = size
        runs.append(fusion.run(wild, prior=PAPER_PRIOR))
    for run in runs[1:]:
        assert_close(run.x, runs[0].x, 1e-4)
        assert run.suspected[30, 0]


@pytest.mark.parametrize("detector", ["gate", "chi-square"])
@LIARS
def test_if_everybody_is_trusted_it_is_the_kalman_filter(square_root: bool, detector: Any) -> None:
    plant = random_plant(6)
    (y, u), prior = random_data(plant, 100, 6, missing=0.1), some_prior(plant)
    settings: dict[str, Any] = {"protected": "auto", "detector": detector, "square_root": square_root}
    run = JointFusion(plant, false_alarm_rate=1e-300, eta=3.0, **settings).run(y, u, prior)
    kalman = KalmanFilter(plant).run(y, u, prior)
    assert run.P is not None and kalman.P is not None and not run.suspected.any()
    assert_close(run.x, kalman.x, 1e-12)
    assert_close(run.P, kalman.P, 1e-12)
    assert_close(run.innovation, kalman.innovation, 1e-12)
    np.testing.assert_array_equal(run.trust, kalman.trust)
    np.testing.assert_array_equal(run.attack, np.where(np.isnan(y), np.nan, 0.0))
    np.testing.assert_array_equal(run.diagnostics["protected"], np.nansum(kalman.trust, axis=1))


@LIARS
@pytest.mark.parametrize("detector", ["gate", "chi-square"])
@pytest.mark.parametrize("seed", range(3))
def test_a_protected_set_that_a_detector_chooses_equals_the_textbook_that_is_told(
    seed: int, detector: Any, square_root: bool
) -> None:
    plant, T = random_plant(seed, radius=0.7), 40
    (y, u), prior, eta = random_data(plant, T, seed, missing=0.1), some_prior(plant), np.array([1.5, 300.0])
    y /= 2
    y[15:25, 2] += 25.0
    settings: dict[str, Any] = {"detector": detector, "square_root": square_root}
    fusion = JointFusion(plant, protected="auto", eta=eta, false_alarm_rate=0.05, **settings)
    run = fusion.run(y, u, prior)
    trusted = run.trust > 0.5
    assert trusted.any(axis=1).all() and (~trusted[:, :2]).any() and trusted[:, :2].any()
    heard = np.repeat(trusted[:, None, plant.channel_sensor], 2, axis=1)
    heard[:, 0, :2] = heard[:, 1, 2] = True
    stacks = [local.stack for local in fusion.locals]
    widths = [len(weak) for weak, _ in stacks]
    each = np.repeat(np.where(trusted[:, :2], 0.0, eta), widths, axis=1)
    book = joint_fusion(plant, stacks, y, u, prior.x, prior.P, each, heard=heard)
    assert run.P is not None
    assert_close(run.x, book.x, 1e-7)
    assert_close(run.P, book.P0, 1e-7)
    for i, (weak, _) in enumerate(stacks):
        told = np.where(trusted[:, [i]], 0.0, book.X[i][:, 3:])
        assert_close(run.attack[:, weak], np.where(np.isnan(y[:, weak]), np.nan, told), 1e-7)


def open_plant() -> Plant:
    """The paper's plant with nobody marked as protected."""
    return Plant(
        PAPER_A, paper_plant().Q, [Sensor(f"s{i + 1}", C=row, R=0.1) for i, row in enumerate(PAPER_C)]
    )


def test_whom_the_detector_suspects_is_stacked_with_those_it_trusts() -> None:
    plant, (_, y) = open_plant(), paper_scenario(1, 60)
    y = y[0]
    y[:, 0] = paper_scenario(1, 60)[0][0] @ PAPER_C[0]
    y[30:, 1] += 40.0
    run = JointFusion(plant, protected="auto", eta=1e3).run(y, prior=PAPER_PRIOR)
    told = InnovationGate(plant).run(y, prior=PAPER_PRIOR)
    np.testing.assert_array_equal(run.suspected, told.suspected)
    np.testing.assert_array_equal(run.trust, told.trust)
    assert run.suspected[30:, 1].all()
    np.testing.assert_array_equal(run.diagnostics["protected"], told.trust.sum(axis=1))
    assert np.abs(run.attack[30:, 1] - 40.0).max() < 4.0
    trusted = told.trust > 0.5
    assert not run.attack[trusted].any() and np.isnan(run.attack_std[trusted]).all()
    assert (run.attack_std[~trusted] > 0).all()
    # With an eta that hides them, those who lie might as well be silent.
    silent = np.where(trusted, y, np.nan)
    assert_close(run.x[30:], KalmanFilter(plant).run(silent, prior=PAPER_PRIOR).x[30:], 0.02)


def test_marked_sensors_are_trusted_whatever_the_detector_says() -> None:
    plant = paper_plant()
    y = np.zeros((5, 5))
    y[2:] = 1e4
    run = JointFusion(plant, protected="auto").run(y, prior=PAPER_PRIOR)
    assert run.suspected[2:, :2].all() and not run.suspected[:, 2:].any()
    np.testing.assert_array_equal(run.trust[2:], [[0, 0, 1, 1, 1]] * 3)
    assert (run.status == Status.OK).all()
    y[4, 2:] = np.nan
    assert JointFusion(plant, protected="auto").run(y, prior=PAPER_PRIOR).status[4] == Status.NO_MEASUREMENT


def test_if_nobody_is_trusted_nothing_is_used() -> None:
    plant = open_plant()
    y = np.zeros((3, 5))
    y[0] = [1.0, 2.0, 0.5, 0.1, 2.2]
    y[1:] = 1e4 * np.array([1, -2, 3, -4, 5])
    run = JointFusion(plant, protected="auto", false_alarm_rate=1e-6).run(y, prior=PAPER_PRIOR)
    assert run.P is not None and run.suspected[1:].all()
    assert run.status.tolist() == [Status.OK, Status.NO_MEASUREMENT, Status.NO_MEASUREMENT]
    np.testing.assert_allclose(run.x[1], PAPER_A @ run.x[0], atol=1e-12)
    np.testing.assert_allclose(run.P[1], PAPER_A @ run.P[0] @ PAPER_A.T + plant.Q, atol=1e-12)
    assert run.diagnostics["protected"].tolist() == [5, 0, 0]

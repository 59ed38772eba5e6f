"""JointFusion step by step: batches, live filters, saved states, outliers, and what it reports."""

from typing import Any

import numpy as np
import pytest

from securestate import Belief, JointFusion, ProtectedKalman, ResumeError
from securestate.estimators import Status
from tests.estimators.joint_cases import (
    PAPER_PAIRS,
    PAPER_PRIOR,
    paper_plant,
    random_data,
    random_plant,
    some_prior,
)
from tests.estimators.run_arrays import RUN_ARRAYS

VARIANTS: dict[str, dict[str, Any]] = {
    "exact": {},
    "square-root": {"square_root": True},
    "printed": {"form": "printed"},
    "adaptive": {"eta": "adaptive"},
    "adaptive-square-root": {"eta": "adaptive", "square_root": True},
    "auto": {"protected": "auto"},
    "auto-chi-square": {"protected": "auto", "detector": "chi-square", "square_root": True},
    "average": {"fusion": "average"},
    "covariance-intersection": {"fusion": "covariance-intersection"},
}


def variant(name: str, seed: int = 3) -> JointFusion:
    return JointFusion(random_plant(seed, radius=0.5), **VARIANTS[name])


@pytest.mark.parametrize("name", VARIANTS)
def test_live_steps_equal_the_run_and_a_saved_state_continues_to_the_bit(name: str) -> None:
    fusion = variant(name)
    y, u = random_data(fusion.plant, 300, 1)
    y[150:155, 1] = np.nan
    y[200] = np.nan
    y[250, 0] = 1e6
    for prior in (None, some_prior(fusion.plant)):
        whole, live, parts = fusion.run(y, u, prior), fusion.start(prior), []
        for k in range(300):
            parts.append(live.step(y[k], u[k]))
            if k % 37 == 0 or 145 < k < 160:
                live = fusion.resume(live.save())
        for quantity in RUN_ARRAYS:
            steps = [getattr(estimate, quantity) for estimate in parts]
            np.testing.assert_array_equal(steps, getattr(whole, quantity), err_msg=quantity)
        for diagnostic, values in whole.diagnostics.items():
            np.testing.assert_array_equal([e.diagnostics[diagnostic] for e in parts], values)


@pytest.mark.parametrize("gaps", ["none", "shared", "own"])
@pytest.mark.parametrize("name", VARIANTS)
def test_batch_equals_loop_to_the_bit(name: str, gaps: str) -> None:
    fusion = variant(name)
    pairs = [random_data(fusion.plant, 300, run, missing=0.05 * (gaps == "own")) for run in range(3)]
    y, u = np.stack([pair[0] for pair in pairs]), np.stack([pair[1] for pair in pairs])
    if gaps == "shared":
        y[:, 150:170, 1] = np.nan
    for prior in (None, some_prior(fusion.plant)):
        batch = fusion.run(y, u, prior)
        for run in range(3):
            single = fusion.run(y[run], u[run], prior)
            for quantity in RUN_ARRAYS:
                np.testing.assert_array_equal(getattr(batch, quantity)[run], getattr(single, quantity))
            for diagnostic, values in batch.diagnostics.items():
                np.testing.assert_array_equal(values[run], single.diagnostics[diagnostic])


@pytest.mark.parametrize("name", VARIANTS)
def test_a_batch_in_blocks_equals_it_in_one(name: str) -> None:
    fusion = variant(name)
    y = np.stack([random_data(fusion.plant, 260, run)[0] for run in range(2)])
    u = random_data(fusion.plant, 260, 0)[1]
    y[:, 130:133, 2] = np.nan
    whole, bank = fusion.run(y, u), fusion.start(runs=2)
    blocks = [bank.run(y[:, a : a + 65], u[a : a + 65]) for a in range(0, 260, 65)]
    for quantity in RUN_ARRAYS:
        joined = np.concatenate([getattr(block, quantity) for block in blocks], axis=1)
        np.testing.assert_array_equal(joined, getattr(whole, quantity), err_msg=quantity)


def test_a_state_of_another_variant_is_refused() -> None:
    designs = [variant(name) for name in VARIANTS]
    designs += [JointFusion(random_plant(3, radius=0.5), eta=2.0), variant("exact", seed=4)]
    designs += [JointFusion(random_plant(3, radius=0.5), eta="adaptive", gate=4.0)]
    blobs = [fusion.start().save() for fusion in designs]
    for i, fusion in enumerate(designs):
        for j, blob in enumerate(blobs):
            if i == j:
                fusion.resume(blob)
            else:
                with pytest.raises(ResumeError, match="another"):
                    fusion.resume(blob)
        with pytest.raises(ResumeError, match="damaged"):
            fusion.resume(blobs[i][:-9])


@pytest.mark.parametrize("name", VARIANTS)
def test_outliers_beyond_all_sizes_and_gaps_leave_every_number_finite(name: str) -> None:
    fusion, rng = variant(name), np.random.default_rng(0)
    T = 10_000 if "square" not in name else 2_000
    y, u = random_data(fusion.plant, T, 0, missing=0.1)
    wild = rng.random(y.shape) < 0.01
    y[wild] = rng.choice([-1.0, 1.0], wild.sum()) * 10.0 ** rng.uniform(0, 300, wild.sum())
    y[rng.random(T) < 0.02] = np.nan
    y[500:700] = np.nan
    run = fusion.run(y, u, covariance=False)
    for quantity in ("x", "x_std", "innovation_std"):
        assert np.isfinite(getattr(run, quantity)).all(), quantity
    gone = np.isnan(y)
    weak = [0, 1, 2]
    assert np.isfinite(run.attack[:, weak][~gone[:, weak]]).all()
    np.testing.assert_array_equal(np.isnan(run.innovation), gone)
    nothing = run.status == Status.NO_MEASUREMENT
    assert nothing[gone.all(axis=1)].all()
    if not name.startswith("auto"):
        np.testing.assert_array_equal(nothing, gone.all(axis=1))
    if name != "printed":
        assert not (run.status == Status.BROKEN_DOWN).any()


def test_reports_say_what_the_protected_sensors_say() -> None:
    plant = paper_plant()
    fusion, beside = JointFusion(plant, pairing=PAPER_PAIRS), ProtectedKalman(plant)
    y, _ = random_data(plant, 100, 4, missing=0.2)
    run, alone = fusion.run(y, prior=PAPER_PRIOR), beside.run(y, prior=PAPER_PRIOR)
    assert alone.P is not None and run.P is not None
    np.testing.assert_array_equal(run.trust, alone.trust)
    np.testing.assert_array_equal(run.suspected, alone.suspected)
    np.testing.assert_allclose(run.diagnostics["trace"], np.trace(run.P, axis1=1, axis2=2))
    np.testing.assert_allclose(run.diagnostics["protected_trace"], np.trace(alone.P, axis1=1, axis2=2))
    gap = (np.abs(run.x - alone.x) / alone.x_std).max(axis=1)
    np.testing.assert_allclose(run.diagnostics["protected_gap"], gap)
    sent = ~np.isnan(y)
    np.testing.assert_array_equal(run.diagnostics["channels"], sent.sum(axis=1))
    np.testing.assert_array_equal(run.diagnostics["protected"], sent[:, 2:].sum(axis=1))
    np.testing.assert_array_equal(run.attack[:, 2:], np.where(sent[:, 2:], 0.0, np.nan))


def test_honest_weak_sensors_raise_as_many_alarms_as_stated_whatever_another_sends() -> None:
    plant, T, rate = paper_plant(), 40_000, 0.02
    rng = np.random.default_rng(2)
    x, y = np.zeros(4), np.empty((T, 5))
    w, v = rng.multivariate_normal(np.zeros(4), plant.Q, T), rng.normal(size=(T, 5)) * np.sqrt(0.1)
    for k in range(T):
        y[k] = plant.C @ x + v[k]
        x = plant.A @ x + w[k]
    y[:, 0] += 10.0 ** rng.uniform(0, 9, T)
    for settings in ({}, {"eta": "adaptive"}):
        run = JointFusion(plant, pairing=PAPER_PAIRS, false_alarm_rate=rate, **settings).run(
            y, covariance=False
        )
        assert run.suspected[:, 1].mean() == pytest.approx(rate, rel=0.1)
        assert run.suspected[:, 0].mean() > 0.8 and not run.suspected[:, 2:].any()


@pytest.mark.parametrize("name", VARIANTS)
def test_a_known_initial_state_is_a_prior_of_zero_covariance(name: str) -> None:
    fusion = variant(name)
    y, u = random_data(fusion.plant, 30, 5)
    run = fusion.run(y, u, Belief(np.ones(3), np.zeros((3, 3))))
    assert run.P is not None and (run.status != Status.BROKEN_DOWN).all()
    np.testing.assert_allclose(run.x[0], 1.0, atol=1e-12)
    np.testing.assert_allclose(run.P[0], 0.0, atol=1e-12)
    assert all(
        np.isfinite(getattr(run, quantity)).all() for quantity in ("x", "x_std", "P", "innovation_std")
    )

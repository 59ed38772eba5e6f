"""Sensors that no other can vouch for: the same estimates, no trust without evidence, in any kind of run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from securestate import Belief, KalmanFilter, OracleFilter, Plant, ResumeError, Sensor, cold_start
from securestate.estimators import METHODS
from securestate.estimators.run import Run
from tests.estimators.run_arrays import RUN_ARRAYS
from tests.estimators.test_window_run import plant_of, records

MARKED = (1, 2, 3)  # s1 lies, s2 is honest, s3 is protected
#: Only this method asks who can be checked before it decides: it names nobody else.
DECIDES = "bias-monitor"
ALONE = np.array([False, True, True, False, False])

#: Saved before sensors could be marked, after the one sample of `early`.
OLD_BLOB = bytes.fromhex(
    "73737461746530317685b18fbc16fbde010000000000000000000000000000000100000000000000000000000000a0bc"
    "0100000000000000790de53594d7f03f00000000000000002f0d8132cb67304a"
)


def marked(plant: Plant, sensors: Sequence[int] = MARKED) -> Plant:
    """The same plant, nobody vouching for these sensors."""
    kept = [s.replaced(verifiable=False) if i in sensors else s for i, s in enumerate(plant.sensors)]
    return Plant(plant.A, plant.Q, kept, B=plant.B, dt=plant.dt)


def with_gaps(runs: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Readings in which s1 lies, s2 is silent for a while, and nobody sends sample 30."""
    y, u = records(plant_of(), runs)
    y[:, 20:24, 2], y[:, 30] = np.nan, np.nan
    return y, u


def assert_only_trust_without_evidence_is_gone(run: Run, plain: Run) -> None:
    for name in RUN_ARRAYS:
        if name != "trust":
            np.testing.assert_array_equal(getattr(run, name), getattr(plain, name), err_msg=name)
    expected = np.where(ALONE & ~plain.suspected, np.nan, plain.trust)
    np.testing.assert_array_equal(run.trust, expected)


@pytest.mark.parametrize("prior", [None, "window"])
@pytest.mark.parametrize("method", [method for method in METHODS if method != DECIDES])
def test_nothing_but_trust_without_evidence_is_gone_in_a_run_and_in_a_batch(
    method: str, prior: object
) -> None:
    y, u = with_gaps(2)
    alone, plain = (METHODS[method].design(plant) for plant in (marked(plant_of()), plant_of()))
    assert_only_trust_without_evidence_is_gone(
        alone.run(y[0], u, prior=prior), plain.run(y[0], u, prior=prior)
    )
    assert_only_trust_without_evidence_is_gone(alone.run(y, u, prior=prior), plain.run(y, u, prior=prior))


@pytest.mark.parametrize("method", METHODS)
def test_a_live_filter_says_the_same_as_a_run(method: str) -> None:
    y, u = with_gaps(1)
    estimator = METHODS[method].design(marked(plant_of()))
    run, live, block = estimator.run(y[0], u), estimator.start(), estimator.start().run(y[0], u)
    steps = [live.step(*sample) for sample in zip(y[0], u, strict=True)]
    np.testing.assert_array_equal([step.trust for step in steps], run.trust)
    np.testing.assert_array_equal(block.trust, run.trust)


def test_runs_that_share_a_plan_share_what_they_do_not_trust() -> None:
    y, u = with_gaps(20)
    alone, plain = KalmanFilter(marked(plant_of())).run(y, u), KalmanFilter(plant_of()).run(y, u)
    assert_only_trust_without_evidence_is_gone(alone, plain)
    np.testing.assert_array_equal(np.isnan(alone.trust[:, 0]), np.broadcast_to(ALONE, (20, 5)))


@pytest.mark.parametrize("method", ["secure", "sparse", "innovation-mixture", "gate"])
def test_a_suspected_sensor_keeps_the_trust_that_the_method_gave(method: str) -> None:
    y, u = with_gaps(1)
    run = METHODS[method].design(marked(plant_of())).run(y[0], u)
    assert run.suspected[:, 1].mean() > 0.5
    assert (run.trust[run.suspected[:, 1], 1] < 0.5).all()


def test_a_cold_start_does_not_trust_who_cannot_be_checked() -> None:
    y, u = records(plant_of(), 1)
    alone, plain = cold_start(marked(plant_of()), y[0], u), cold_start(plant_of(), y[0], u)
    assert plain.suspected[:, 1].all()
    assert (plain.trust[:, 2] >= 0.5).all()
    assert np.isnan(alone.trust[:, 2]).all()
    np.testing.assert_array_equal(alone.trust[:, [0, 1, 3, 4]], plain.trust[:, [0, 1, 3, 4]])
    np.testing.assert_array_equal(alone.belief.x, plain.belief.x)


def test_an_oracle_is_told_about_liars_and_not_that_others_are_honest() -> None:
    y, u = with_gaps(1)
    attacked = np.arange(5) == 1
    alone, plain = (
        OracleFilter(plant).run(y[0], u, attacked=attacked) for plant in (marked(plant_of()), plant_of())
    )
    assert_only_trust_without_evidence_is_gone(alone, plain)


def early(sensors: Sequence[int] = (), *, scale: float = 2.0) -> KalmanFilter:
    plant = Plant(
        [[[0.5]], [[0.75]], [[0.5]]],
        [[1.0]],
        [Sensor("a", C=[1.0], R=2.0), Sensor("b", C=[2.0], R=1.0, offset=3.0, scale=scale)],
    )
    return KalmanFilter(marked(plant, sensors))


@pytest.mark.parametrize("sensors", [(), (0,)])
def test_a_filter_saved_before_sensors_could_be_marked_resumes(sensors: tuple[int, ...]) -> None:
    live = early(sensors).start(Belief([1.0], [[4.0]]))
    live.step([1.5, 2.0])
    assert live.save() == OLD_BLOB
    step, again = live.step([2.5, np.nan]), early(sensors).resume(OLD_BLOB).step([2.5, np.nan])
    np.testing.assert_array_equal(again.x, step.x)
    np.testing.assert_array_equal(again.trust, [np.nan if sensors else 1.0, np.nan])
    with pytest.raises(ResumeError):
        early(sensors, scale=3.0).resume(OLD_BLOB)

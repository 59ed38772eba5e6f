"""The secure filter: what its statuses say, and which designs it refuses."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2, norm

from securestate import Belief, DesignError, InputError, Plant, Run, SecureFilter, Sensor, Status
from securestate.estimators.secure_filter import BROAD, MARGIN, onset_probability
from tests.estimators.mixture_cases import scalar_plant

# ---------------------------------------------------------------- statuses


def equal_sensors(values: list[float], R: list[float] | None = None) -> Run:
    sensors = [Sensor(f"s{i}", C=[1.0], R=R[i] if R else 0.01) for i in range(len(values))]
    return SecureFilter(Plant([[1.0]], [[1.0]], sensors)).run([values], prior=Belief([0.0], [[4.0]]))


def test_two_pairs_that_contradict_each_other_are_ambiguous_and_p_holds_both() -> None:
    run = equal_sensors([0.5, 0.6, -0.6, -0.65, -0.2], [0.01] * 4 + [40.0])
    assert run.status[0] == Status.AMBIGUOUS and run.diagnostics["rival"][0] > 0.05
    assert abs(run.x[0, 0]) < 0.5 < run.x_std[0, 0]  # .07 if either pair were believed
    assert run.trust[0, 4] > 0.9 and (np.abs(run.trust[0, :4] - 0.5) < 0.3).all()


@pytest.mark.filterwarnings("ignore::securestate.InsecureWarning")
def test_half_against_half_is_a_majority_that_is_suspected() -> None:
    run = equal_sensors([1.9, 2.0, -1.95, -2.05])
    assert run.status[0] == Status.MAJORITY_SUSPECT and run.suspected.sum() == 2


def test_a_majority_that_is_suspected_is_said() -> None:
    run = equal_sensors([30.0, -20.0, 11.0, 0.1, -44.0])
    assert run.status[0] == Status.MAJORITY_SUSPECT and run.suspected.sum() >= 3


def test_nothing_heard_is_a_prediction() -> None:
    run = equal_sensors([np.nan] * 5)
    assert run.status[0] == Status.NO_MEASUREMENT and run.x[0, 0] == 0.0 and run.x_std[0, 0] == 2.0
    assert np.isnan(run.trust).all() and not run.suspected.any() and np.isnan(run.attack).all()


def test_a_prior_too_wide_for_the_digits_is_ill_conditioned() -> None:
    sensors = [Sensor(f"s{i}", C=[1.0], R=1e-6) for i in range(3)]
    estimator = SecureFilter(Plant([[1.0]], [[1e-6]], sensors))
    wide, sane = (estimator.run([[1.0, 1.0, 1.0]], prior=Belief([0.0], [[P]])) for P in (1e9, 1e4))
    assert wide.status[0] == Status.ILL_CONDITIONED and sane.status[0] == Status.OK


# ---------------------------------------------------------------- design


def test_a_false_alarm_rate_out_of_range_is_refused() -> None:
    plant = scalar_plant(5)
    for rate in (0.0, -1.0, 0.11, 1.0, float("nan"), True, "0.01", None):
        with pytest.raises(InputError, match="false_alarm_rate"):
            SecureFilter(plant, false_alarm_rate=rate)  # type: ignore[arg-type]
    assert SecureFilter(plant, false_alarm_rate=0.1).settings == {"false_alarm_rate": 0.1}


def test_sensors_that_share_noise_are_refused() -> None:
    sensors = [Sensor(f"s{i}", C=[1.0]) for i in range(3)]
    with pytest.raises(DesignError):
        SecureFilter(Plant([[0.9]], [[1.0]], sensors, R=np.eye(3) + 0.2))


def test_one_sample_is_as_likely_a_lie_as_not_at_the_threshold() -> None:
    for rate in (1e-4, 1e-3, 1e-2):
        p = onset_probability(np.array([1, 2, 3]), rate)
        z = np.sqrt((1 + MARGIN) * chi2.isf(rate, 1))
        honest, lie = norm.pdf(z), norm.pdf(z, scale=np.sqrt(1 + BROAD))
        assert p[0] * lie == pytest.approx((1 - p[0]) * honest, rel=1e-9)
        assert (p <= p[0]).all() and (p > 0).all()

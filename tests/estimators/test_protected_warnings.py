"""What methods with protected sensors warn of at design time."""

import warnings
from collections.abc import Callable

import numpy as np
import pytest

from securestate import (
    AdaptiveJointFilter,
    AdaptiveKalman,
    AugmentedKalman,
    Estimator,
    JointFusion,
    Plant,
    SecurestateWarning,
    Sensor,
)

JUDGES: list[Callable[[Plant], Estimator]] = [AdaptiveJointFilter, AugmentedKalman, AdaptiveKalman]


def scaled(scale: float) -> Plant:
    """A weak sensor whose noise has the variance 0.1 scale², and a protected one."""
    weak = Sensor("pressure", C=[1.0], R=0.1, scale=scale, unit="mbar")
    return Plant([[0.9]], [[0.1]], [weak, Sensor("safe", C=[1.0], R=0.1, protected=True)])


@pytest.mark.parametrize("design", JUDGES)
def test_a_growing_mode_that_no_protected_sensor_sees_is_warned_of(
    design: Callable[[Plant], Estimator],
) -> None:
    sensors = [Sensor("weak", C=[1.0, 1.0], R=0.1), Sensor("safe", C=[1.0, 0.0], R=0.1, protected=True)]
    plant = Plant(np.diag([0.9, 1.02]), 0.1 * np.eye(2), sensors, state_names=["level", "drift"])
    with pytest.warns(SecurestateWarning, match=r"do not see mode 1.02 \(drift\)"):
        design(plant)


def test_an_eta_far_below_the_noise_is_warned_of_in_the_unit_of_the_sensor() -> None:
    with pytest.warns(
        SecurestateWarning, match=r"eta is 1 \(mbar\)² for 'pressure', far below the variance 1e\+03"
    ):
        JointFusion(scaled(100.0))


def test_an_attack_noise_far_below_the_noise_is_warned_of() -> None:
    with pytest.warns(SecurestateWarning, match="attack_noise is 1 "):
        AugmentedKalman(scaled(100.0))
    with pytest.warns(SecurestateWarning, match="attack_noise is 1 "):
        AdaptiveKalman(scaled(100.0), attack_start=1.0)


def test_nothing_is_said_of_an_eta_that_fits_is_zero_or_adapts() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for eta in (1000.0, 0.0, "adaptive"):
            JointFusion(scaled(100.0), eta=eta)
        AugmentedKalman(scaled(100.0), attack_noise=1000.0)


def test_the_printed_form_finds_its_steady_state_although_its_moments_settle_slowly() -> None:
    sensors = [
        Sensor("pair", C=[[0.0, 1.0], [1.0, 1.0]], R=[0.2, 0.3]),
        Sensor("safe", C=[1.0, 0.0], R=0.1, protected=True),
        Sensor("sound", C=[0.0, 1.0], R=0.1, protected=True),
    ]
    estimator = JointFusion(
        Plant([[0.9, 0.1], [0.0, 0.8]], 0.1 * np.eye(2), sensors), eta=10.0, form="printed"
    )
    assert estimator.no_steady_state == ""
    run = estimator.run(np.zeros((3, 4)))
    np.testing.assert_array_equal(run.status, 0)

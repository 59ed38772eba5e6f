"""All attacked sensors tell the same wrong state."""

import numpy as np
import pytest

from securestate import DesignError, InputError, Plant, Sensor
from securestate._steady_state import steady_state
from securestate.attacks import FakeState, Redrawn
from tests.attacks.scenes import injected, many, scene, vehicle

D = np.array([1.0, 0.0, -2.0, 0.5])
#: scale * C D, channel by channel.
TOLD = np.array([2.0 * 1.0, 0.5 * 2 * -2.0, 3.0 * 1.0, 0.1 * -2.0, 0.0])


def test_a_constant_lie() -> None:
    a = injected(FakeState(D.tolist(), on=[0, 1, 2], start=6), scene(vehicle()))
    np.testing.assert_allclose(a[:, 6:], np.broadcast_to(TOLD, (3, 34, 5)))


def test_a_lie_that_grows() -> None:
    a = injected(FakeState(D.tolist(), "ramp", on=["x", "gps"], start=6), scene(vehicle()))
    np.testing.assert_allclose(a[1, 6:, 0], TOLD[0] * np.arange(34))
    np.testing.assert_allclose(a[1, 6:, 3], TOLD[3] * np.arange(34))
    assert np.all(a[:, :, 1] == 0)


def test_a_lie_that_swings() -> None:
    a = injected(FakeState(2.0, "sinusoid", period=25, on=Redrawn(2), start=6), scene(many()))
    wave = 2.0 * np.sin(2 * np.pi * np.arange(34) / 25)
    for i in range(7):
        told = a[0, 6:, i]
        lies = told != 0
        np.testing.assert_allclose(told[lies], (1 + i / 5) * wave[lies])


def test_a_lie_in_prior_standard_deviations_goes_where_the_filter_is_least_certain() -> None:
    plant = vehicle()
    P = steady_state(plant).P_prior
    a = injected(FakeState(3.0, along="prior", on=[0, 1, 2]), scene(plant))[0, 0, :4]
    d = np.array([a[0] / 2.0, np.nan, a[1] / 1.0, np.nan])  # positions told by x and y
    variances, directions = np.linalg.eigh(P)
    expected = 3.0 * np.sqrt(variances[-1]) * directions[:, -1]
    expected *= np.sign(expected[np.argmax(np.abs(expected))])
    np.testing.assert_allclose(d[[0, 2]], expected[[0, 2]], rtol=1e-9)
    assert expected @ np.linalg.solve(P, expected) == pytest.approx(9.0)


def test_sensors_that_vary_in_time_tell_what_they_would_see_at_that_sample() -> None:
    C = np.arange(1.0, 13.0).reshape(12, 1, 1)
    plant = Plant([[0.9]], [[1.0]], [Sensor("a", C=C, R=1.0), Sensor("b", C=[1.0], R=1.0)])
    clean = scene(many(2), steps=10)
    given = type(clean)(plant, clean.x, clean.u, clean.v, clean.y, clean.rngs)
    np.testing.assert_allclose(injected(FakeState(2.0, on="a"), given)[0, :, 0], 2.0 * np.arange(1.0, 11.0))
    with pytest.raises(DesignError, match="a time-varying plant has no steady state"):
        injected(FakeState(2.0, along="prior", on="a"), given)


def test_a_shift_of_another_number_of_states_is_refused() -> None:
    with pytest.raises(InputError, match="shift: expected one number or 4, one per state, received 2"):
        injected(FakeState([1.0, 2.0], on="x"), scene(vehicle()))

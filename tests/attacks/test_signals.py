"""Every adversary that needs no plant injects what its definition says, on numbers written out here."""

from dataclasses import replace

import numpy as np
import pytest

from securestate import InputError
from securestate.attacks import (
    Bias,
    Delay,
    Denial,
    Freeze,
    NoiseLinear,
    Pulse,
    Ramp,
    RandomNoise,
    RandomWalk,
    Replay,
    Scale,
    Sinusoid,
)
from securestate.attacks.base import Attack
from tests.attacks.scenes import Float, injected, many, scene, vehicle

#: scale * sqrt(R) of the vehicle's channels.
NOISE = np.array([2.0 * 1.0, 0.5 * np.sqrt(2.0), 3.0 * 1.0, 0.1 * np.sqrt(2.0), np.sqrt(0.5)])


def on_x(attack: Attack, steps: int = 10) -> Float:
    """The injection into sensor "x" of the first run."""
    return injected(attack, scene(vehicle(), steps))[0, :, 0]


def test_bias() -> None:
    np.testing.assert_array_equal(on_x(Bias(3.0, on="x", start=7)), [0] * 7 + [3.0] * 3)
    np.testing.assert_array_equal(on_x(Bias(3.0, unit="noise", on="x", start=7)), [0] * 7 + [6.0] * 3)


def test_bias_per_channel_in_units_of_the_noise() -> None:
    a = injected(Bias([1, 2, 3, 4, 5], unit="noise", on=["x", "gps"]), scene(vehicle()))
    np.testing.assert_allclose(a[1, 4], NOISE * [1, 0, 3, 4, 0], rtol=1e-15)


def test_bias_with_random_signs_draws_once_per_run_and_channel() -> None:
    a = injected(Bias(3.0, signs="random", on=[0, 1, 2]), scene(vehicle(), runs=200))[..., :4]
    assert np.all(np.abs(a) == 3.0)
    assert np.all(a == a[:, :1])
    assert np.all(np.abs(a[:, 0].mean(axis=0)) < 3.0 * 4 / np.sqrt(200))
    assert not np.all(a[:, 0, 2] == a[:, 0, 3])


def test_ramp() -> None:
    np.testing.assert_allclose(on_x(Ramp(0.5, on="x", start=6)), [0] * 6 + [0, 0.5, 1.0, 1.5])
    np.testing.assert_allclose(on_x(Ramp(-0.5, limit=0.8, on="x", start=6)), [0] * 7 + [-0.5, -0.8, -0.8])
    np.testing.assert_allclose(on_x(Ramp(0.5, 0.8, "noise", on="x", start=6)), [0] * 7 + [1.0, 1.6, 1.6])


def test_sinusoid() -> None:
    quarter = on_x(Sinusoid(2.0, period=4, on="x", start=5))
    np.testing.assert_allclose(quarter, [0] * 5 + [0, 2, 0, -2, 0], atol=1e-15)
    late = on_x(Sinusoid(2.0, period=12, phase=30, unit="noise", on="x", start=8))
    np.testing.assert_allclose(late[8:], 4 * np.sin(np.pi * np.array([1 / 6, 1 / 3])))


def test_a_sinusoid_of_period_2_and_phase_90_alternates_exactly() -> None:
    a = on_x(Sinusoid(2.0, period=2, phase=90, on="x"), steps=1000)
    np.testing.assert_array_equal(a, np.tile([2.0, -2.0], 500))


def test_regular_pulses() -> None:
    np.testing.assert_array_equal(on_x(Pulse(5.0, on="x", start=4)), [0, 0, 0, 0, 5, 0, 0, 0, 0, 0])
    np.testing.assert_array_equal(on_x(Pulse(5.0, 3, on="x", start=2)), [0, 0, 5, 0, 0, 5, 0, 0, 5, 0])
    wide = on_x(Pulse(5.0, 4, width=2, on="x", start=3))
    np.testing.assert_array_equal(wide, [0, 0, 0, 5, 5, 0, 0, 5, 5, 0])


def test_random_pulses_come_as_often_as_asked_with_either_sign_on_each_channel() -> None:
    a = injected(Pulse(2.0, probability=0.1, unit="noise", on="gps"), scene(vehicle(), steps=4000, runs=5))
    units = a[..., 2:4] / NOISE[2:4]
    assert set(np.round(units, 12).ravel()) == {-2.0, 0.0, 2.0}
    assert np.mean(units > 0) == pytest.approx(0.05, abs=4 * np.sqrt(0.05 / 40000))
    assert np.mean(units < 0) == pytest.approx(0.05, abs=4 * np.sqrt(0.05 / 40000))
    assert np.mean(np.all(units != 0, axis=-1)) == pytest.approx(0.01, abs=4 * np.sqrt(0.01 / 20000))


def test_random_pulses_last_as_long_as_asked_and_the_latest_one_counts() -> None:
    given = scene(vehicle(), steps=300, runs=1)
    short = injected(Pulse(1.0, probability=0.2, on="x", start=10), given)[0, :, 0]
    wide = injected(Pulse(1.0, probability=0.2, width=3, on="x", start=10), given)[0, :, 0]
    for k in range(300):
        recent = [value for value in short[max(k - 2, 0) : k + 1] if value]
        assert wide[k] == (recent[-1] if recent else 0.0)


@pytest.mark.parametrize("distribution", ["gaussian", "laplace"])
def test_random_noise_has_the_standard_deviation_and_tails_asked_for(distribution: str) -> None:
    noise = RandomNoise(2.0, distribution=distribution, unit="noise", on=[0, 1])  # type: ignore[arg-type]
    a = injected(noise, scene(vehicle(), steps=20000, runs=2))[..., :2] / NOISE[:2]
    assert np.std(a) == pytest.approx(2.0, rel=0.02)
    assert np.mean(a) == pytest.approx(0.0, abs=0.04)
    assert np.mean(a**4) / np.var(a) ** 2 == pytest.approx(3 if distribution == "gaussian" else 6, rel=0.1)


def test_random_noise_has_the_covariance_asked_for() -> None:
    S = np.zeros((5, 5))
    S[np.ix_([0, 2, 3], [0, 2, 3])] = [
        [4.0, 2.0, 0.0],
        [2.0, 1.0, 0.0],
        [0.0, 0.0, 9.0],
    ]
    noise = RandomNoise(covariance=S.tolist(), on=["x", "gps"])
    a = injected(noise, scene(vehicle(), steps=20000, runs=2)).reshape(-1, 5)
    np.testing.assert_allclose(a.T @ a / len(a), S, atol=0.2)
    np.testing.assert_allclose(a[:, 0], 2 * a[:, 2], atol=1e-6)
    scaled = injected(replace(noise, unit="noise"), scene(vehicle(), steps=20000, runs=2)).reshape(-1, 5)
    np.testing.assert_allclose(scaled, a * NOISE)


def test_a_covariance_that_does_not_fit_the_plant_is_refused() -> None:
    with pytest.raises(InputError, match=r"covariance: expected \(5, 5\), one row per channel, received"):
        injected(RandomNoise(covariance=[[1.0]], on="x"), scene(vehicle()))


def test_a_random_walk_is_the_sum_of_white_steps_from_the_start() -> None:
    a = injected(RandomWalk(0.5, unit="noise", on=[0, 1], start=10), scene(vehicle(), steps=4010, runs=4))
    e = np.diff(a[:, 9:, :2], axis=1) / NOISE[:2]
    assert np.all(e != 0)
    assert np.std(e) == pytest.approx(0.5, rel=0.03)
    assert abs(np.mean(e[:, 1:] * e[:, :-1])) < 4 * 0.25 / np.sqrt(e.size)


def test_freeze() -> None:
    given = scene(vehicle())
    sent = given.y + injected(Freeze(on="gps", start=12), given)
    np.testing.assert_allclose(sent[:, 12:, 2:4], np.repeat(given.y[:, 11:12, 2:4], 28, axis=1))
    sent = given.y + injected(Freeze(on="gps"), given)
    np.testing.assert_allclose(sent[:, :, 2:4], np.repeat(given.y[:, :1, 2:4], 40, axis=1))


def test_scale() -> None:
    given = scene(vehicle())
    y = given.y[:, 5:, 0]
    sent = given.y + injected(Scale(0.25, about=10.0, on="x", start=5), given)
    np.testing.assert_allclose(sent[:, 5:, 0], 10.0 + 0.25 * (y - 10.0))
    np.testing.assert_allclose((given.y + injected(Scale(0.0, on="x"), given))[:, :, 0], 0.0, atol=1e-12)


def test_replay() -> None:
    given = scene(vehicle(), steps=12)
    sent = (given.y + injected(Replay(3, on="gps", start=5), given))[:, :, 2:4]
    order = [0, 1, 2, 3, 4, 2, 3, 4, 2, 3, 4, 2]
    np.testing.assert_allclose(sent, given.y[:, order, 2:4])


def test_delay() -> None:
    given = scene(vehicle(), steps=8)
    sent = (given.y + injected(Delay(3, on="gps", start=2), given))[:, :, 2:4]
    np.testing.assert_allclose(sent[:, 3:], given.y[:, :5, 2:4])
    np.testing.assert_array_equal(sent[:, :2], given.y[:, :2, 2:4])
    assert np.all(np.isnan(sent[:, 2]))
    assert np.all(np.isnan(injected(Delay(20, on="x"), given)[:, :, 0]))


def test_denial() -> None:
    always = injected(Denial(on="gps", start=30), scene(vehicle()))
    assert np.all(np.isnan(always[:, 30:, 2:4]))
    assert np.all(always[:, :30] == 0)
    often = np.isnan(injected(Denial(0.3, on="gps"), scene(vehicle(), steps=5000)))
    assert np.all(often[..., 2] == often[..., 3])
    assert np.mean(often[..., 2]) == pytest.approx(0.3, abs=4 * np.sqrt(0.21 / 15000))
    assert not np.isnan(injected(Denial(0.0, on="gps"), scene(vehicle()))).any()


def test_noise_linear_shares_beta_and_theta_as_asked() -> None:
    """Two runs of the channels of a sensor are beta v + theta with the same two numbers."""
    given = scene(vehicle(), steps=50)
    v = given.v
    sensor = injected(NoiseLinear(redraw="sensor", on=[0, 1, 2]), given)
    for run in range(3):
        beta = (sensor[run, 1, 2] - sensor[run, 0, 2]) / (v[run, 1, 2] - v[run, 0, 2])
        theta = sensor[run, 0, 2] - beta * v[run, 0, 2]
        np.testing.assert_allclose(sensor[run, :, 2:4], beta * v[run, :, 2:4] + theta, rtol=1e-8)
        assert abs(beta) < 5
        assert abs(theta) < 10
        assert not np.allclose(sensor[run, :, 0], beta * v[run, :, 0] + theta)
    shared = injected(NoiseLinear(redraw="run", on=[0, 1, 2]), given)
    for run in range(3):
        beta = (shared[run, 1, 0] - shared[run, 0, 0]) / (v[run, 1, 0] - v[run, 0, 0])
        theta = shared[run, 0, 0] - beta * v[run, 0, 0]
        np.testing.assert_allclose(shared[run, :, :4], beta * v[run, :, :4] + theta, rtol=1e-8)


def test_noise_linear_draws_afresh_from_its_intervals() -> None:
    given = scene(many(), steps=3000)
    only_theta = injected(NoiseLinear(beta=(0, 0), theta=(2, 4), unit="noise", on=[0, 6]), given)[..., [0, 6]]
    theta = only_theta / np.array([1.0, np.sqrt(3.0)])
    assert 2 <= theta.min() < 2.01 < 3.99 < theta.max() <= 4
    assert np.mean(theta) == pytest.approx(3, abs=0.03)
    only_beta = injected(NoiseLinear(theta=(0, 0), on=0), given)[..., 0] / given.v[..., 0]
    assert -5 <= only_beta.min() < -4.9 < 4.9 < only_beta.max() <= 5
    assert np.std(only_beta) == pytest.approx(10 / np.sqrt(12), rel=0.03)

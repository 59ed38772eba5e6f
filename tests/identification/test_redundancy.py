"""What the others say of a sensor: by a filter without it, and by a joint Gaussian of all readings."""

import numpy as np
import pytest
from numpy.typing import NDArray

from securestate.identification.forms import Innovations, innovations_of, radius, spread
from securestate.identification.redundancy import CONFIDENCE, explained, left_out
from tests.identification.identification_cases import innovations_record, plant_of, random_model, record
from tests.reference.identification import innovations_gaussian, one_reading
from tests.reference.kalman import textbook_filter

Array = NDArray[np.float64]


def shared_noises(seed: int, n: int = 2, m: int = 3) -> Innovations:
    """Noises that sensors share with each other and with what drives the state."""
    rng, model = np.random.default_rng(seed), random_model(seed, n, m, q=0, radius=0.7)
    G, K = rng.normal(size=(m, m)), rng.normal(size=(n, m))
    while radius(model.A - K @ model.C) > 0.75:
        K = 0.8 * K
    return Innovations(model.A, model.B, model.C, model.D, K, G @ G.T + 0.2 * np.eye(m))


@pytest.mark.parametrize("channels", [[0], [2], [1, 3]])
def test_with_independent_noises_it_is_a_kalman_filter_that_does_not_hear_the_sensor(
    channels: list[int],
) -> None:
    model = random_model(1, n=2, m=4, q=2)
    y, u = record(model, 300, 2)
    deaf = y.copy()
    deaf[:, channels] = np.nan
    book = textbook_filter(plant_of(model), deaf, u, np.zeros(2), spread(model.A, model.Q))
    expected = y[:, channels] - book.x @ model.C[channels].T - u @ model.D[channels].T
    [remains] = left_out(innovations_of(model), np.array(channels), [(y, u)])
    np.testing.assert_allclose(remains[150:], expected[150:], atol=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_with_shared_noises_it_is_what_the_joint_gaussian_expects_of_the_sensor(seed: int) -> None:
    form, N = shared_noises(seed), 90
    y = innovations_record(form, N, seed)
    start = spread(form.A, form.K @ form.S @ form.K.T)
    prior = innovations_gaussian(form.A, form.C, form.K, form.S, np.zeros((N, 2)), np.zeros((N, 3)), start)
    for channel in range(3):
        [remains] = left_out(form, np.array([channel]), [(y, np.zeros((N, 0)))])
        for k in (70, N - 1):
            assert remains[k, 0] == pytest.approx(y[k, channel] - one_reading(prior, y, channel, k), abs=1e-5)


def test_the_sensors_own_reading_does_not_matter() -> None:
    form = shared_noises(5)
    y, nothing = innovations_record(form, 100, 5), np.zeros((100, 0))
    lying = y.copy()
    lying[:, 1] += 7 * np.sin(np.arange(100))
    (honest,), (lie,) = (left_out(form, np.array([1]), [(each, nothing)]) for each in (y, lying))
    np.testing.assert_allclose(lie - honest, (lying - y)[:, [1]], atol=1e-10)


def test_the_only_sensor_is_predicted_by_inputs_alone() -> None:
    model = random_model(6, n=2, m=1, q=1, radius=0.7)
    y, u = record(model, 500, 6)
    [remains] = left_out(innovations_of(model), np.array([0]), [(y, u)])
    x, expected = np.zeros(2), []
    for v in u:
        expected.append(model.C @ x + model.D @ v)
        x = model.A @ x + model.B @ v
    np.testing.assert_allclose(remains[100:], (y - np.array(expected))[100:], atol=1e-9)


def test_every_segment_is_on_its_own() -> None:
    form = shared_noises(7)
    parts = [(innovations_record(form, N, N), np.zeros((N, 0))) for N in (40, 3, 25)]
    together = left_out(form, np.array([0]), parts)
    for part, remains in zip(parts, together, strict=True):
        np.testing.assert_allclose(remains, left_out(form, np.array([0]), [part])[0], atol=1e-10)


def test_the_share_explained_is_one_less_the_ratio_of_variances() -> None:
    rng = np.random.default_rng(8)
    said = 3 + rng.normal(size=(2000, 1))
    left = 0.5 * rng.normal(size=(2000, 1))
    share, least = explained([left], [said])
    assert share == pytest.approx(1 - np.mean(left**2) / np.var(said), rel=1e-12)
    assert least < share


def test_of_several_channels_the_one_that_is_explained_least_counts_and_missing_readings_do_not() -> None:
    rng = np.random.default_rng(9)
    said = rng.normal(size=(500, 2))
    left = said * [0.1, 0.8] * rng.choice([-1, 1], size=(500, 2))
    poor = explained([left[:, 1:]], [said[:, 1:]])
    assert explained([left], [said]) == poor
    gappy = left.copy()
    gappy[100:200] = np.nan
    assert explained([gappy[:, 1:]], [said[:, 1:]]) == explained(
        [np.delete(left[:, 1:], np.s_[100:200], axis=0)], [np.delete(said[:, 1:], np.s_[100:200], axis=0)]
    )


@pytest.mark.parametrize("hardly_read", [[0], [1], [0, 1]])
def test_a_sensor_with_a_channel_that_was_hardly_read_has_no_number(hardly_read: list[int]) -> None:
    left, said = np.ones((60, 2)), np.arange(120.0).reshape(60, 2)
    assert np.isfinite(explained([left], [said])).all()
    said[49:, hardly_read] = np.nan
    assert np.isnan(explained([left], [said])).all()


@pytest.mark.parametrize("share", [0.3, 0.5, 0.8])
def test_explained_least_is_below_the_truth_in_ninety_percent_of_records(share: float) -> None:
    """Samples depend on each other; 95 % is wanted, and 90 % of 300 is 3.9 standard errors less."""
    rng, a = np.random.default_rng(10), 0.7
    drive, x = rng.normal(size=(300, 700, 2)), np.zeros((300, 700, 2))
    for k in range(1, 700):
        x[:, k] = a * x[:, k - 1] + np.sqrt(1 - a**2) * drive[:, k]
    sides = np.zeros(300, dtype=bool)
    for i in range(300):
        known, left = np.sqrt(share) * x[i, 100:, :1], np.sqrt(1 - share) * x[i, 100:, 1:]
        sides[i] = explained([left], [known + left])[1] <= share
    assert np.mean(sides) >= 0.9
    assert CONFIDENCE < 2  # a bound that is always below would be worth nothing
    assert np.mean(sides) < 1

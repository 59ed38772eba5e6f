"""The E-step, with and without gaps, against one joint Gaussian of all states and readings."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from securestate.identification.expectation import Moments, expect, expect_with_gaps
from securestate.identification.forms import Independent, Segment, Stack, spread, stationary
from tests.identification.identification_cases import random_model, record, with_gaps
from tests.reference.identification import conditioned, joint, moments

Array = NDArray[np.float64]
NAMES = ("zz", "zx", "xx", "gg", "gy", "yy")


def of_the_joint_gaussian(model: Independent, segments: list[Segment]) -> tuple[float, dict[str, Array]]:
    """Each segment starts from the covariance of the long run."""
    start = spread(model.A, model.Q + model.B @ model.B.T)
    likelihood, sums = 0.0, {}
    for y, u in segments:
        known, density = conditioned(joint(model, u, np.zeros(model.n), start), y)
        likelihood += density
        sums = {name: sums.get(name, 0) + each for name, each in moments(known, u).items()}
    return likelihood, sums


def assert_equal(found: Moments, likelihood: float, sums: dict[str, Array]) -> None:
    np.testing.assert_allclose(found.likelihood, likelihood, rtol=1e-9)
    for name in NAMES:
        np.testing.assert_allclose(getattr(found, name), sums[name], rtol=1e-8, atol=1e-8, err_msg=name)


def short(model: Independent, lengths: tuple[int, ...], seed: int) -> list[Segment]:
    return [record(model, N, seed + i) for i, N in enumerate(lengths)]


@pytest.mark.parametrize(("n", "m", "q"), [(1, 1, 0), (2, 3, 1), (3, 2, 2)])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.8])
def test_with_gaps_moments_and_likelihood_are_those_of_the_joint_gaussian(
    n: int, m: int, q: int, share: float
) -> None:
    model = random_model(n, n, m, q)
    segments = [(with_gaps(y, share, 7), u) for y, u in short(model, (12, 1, 6), 20)]
    assert_equal(expect_with_gaps(model, segments), *of_the_joint_gaussian(model, segments))


def test_samples_and_segments_that_are_wholly_missing_are_estimated_like_others() -> None:
    model = random_model(3)
    (y, u), (nothing, v) = short(model, (12, 4), 30)
    y[0], y[5:8], y[-1], nothing[:] = np.nan, np.nan, np.nan, np.nan
    segments = [(y, u), (nothing, v)]
    assert_equal(expect_with_gaps(model, segments), *of_the_joint_gaussian(model, segments))


def stationary_start(model: Independent, y: Array, u: Array) -> Array:
    """The predicted state that a segment most likely starts from, by all of its readings.

    x[0] = what is predicted + error; the error has the filter's covariance P, what is predicted the rest of
    the long run's X.
    """
    P = stationary(model).P
    X = spread(model.A, model.Q + model.B @ model.B.T)
    before = joint(model, u, np.zeros(model.n), P)
    sees = np.vstack([model.C @ np.linalg.matrix_power(model.A, k) for k in range(len(y))])
    rest = X - P
    S = sees @ rest @ sees.T + before.readings_cov
    return np.asarray(rest @ sees.T @ np.linalg.solve(S, y.ravel() - before.readings))


@pytest.mark.parametrize(("n", "m", "q"), [(1, 1, 0), (2, 3, 1), (2, 6, 1), (3, 2, 2)])
def test_without_gaps_likelihood_and_means_are_those_of_a_filter_that_is_stationary_from_its_likeliest_start(
    n: int, m: int, q: int
) -> None:
    some = random_model(n + 10, n, m, q)
    model = replace(some, r=20 * some.r)  # slow to forget: the start is felt in every sample
    segments = short(model, (12, 1, 5), 40)
    found = expect(model, Stack(segments))
    likelihood, products = 0.0, np.zeros((n + q, m))
    for y, u in segments:
        start = stationary_start(model, y, u)
        known, density = conditioned(joint(model, u, start, stationary(model).P), y)
        likelihood += density
        products += moments(known, u)["gy"]
    np.testing.assert_allclose(found.likelihood, likelihood, rtol=1e-9)
    np.testing.assert_allclose(found.gy, products, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(found.yy, sum((y**2).sum(axis=0) for y, _ in segments), rtol=1e-12)


def test_without_gaps_covariances_are_those_in_the_middle_of_a_long_record() -> None:
    model = random_model(5, radius=0.7)
    n, long = model.n, 41
    y, u = record(model, long, 50)
    known, _ = conditioned(joint(model, u, np.zeros(n), spread(model.A, model.Q)), y)
    k = long // 2 * n
    middle, next_to_it = known.cov[k : k + n, k : k + n], known.cov[k : k + n, k + n : k + 2 * n]
    # Of readings that are all zero the means are zero, so that only covariances are left.
    silent = expect(model, Stack([(np.zeros_like(y), np.zeros_like(u))]))
    np.testing.assert_allclose(silent.gg[:n, :n] / long, middle, rtol=1e-6)
    np.testing.assert_allclose(silent.zz[:n, :n] / (long - 1), middle, rtol=1e-6)
    np.testing.assert_allclose(silent.xx / (long - 1), middle, rtol=1e-6)
    np.testing.assert_allclose(silent.zx[:n] / (long - 1), next_to_it, rtol=1e-6)


def test_on_long_segments_both_e_steps_agree() -> None:
    """They differ in the first and last samples of a segment only: a share of 1 / N."""
    model = random_model(6)
    errors = []
    for N in (100, 1000):
        segments = short(model, (N, N), 60)
        found, exact = expect(model, Stack(segments)), expect_with_gaps(model, segments)
        assert found.likelihood / exact.likelihood == pytest.approx(1, abs=2 / N)
        errors.append(
            max(
                np.max(np.abs(getattr(found, a) - getattr(exact, a))) / np.max(np.abs(exact.gg))
                for a in NAMES
            )
        )
    assert errors[1] < 0.3 * errors[0] < 0.01


def test_the_likelihood_of_many_channels_is_that_of_few_with_another_formula() -> None:
    """From m = 2 n on; a channel that sees nothing adds the density of its noise, whatever the formula."""
    model = random_model(8, n=2, m=4)
    fewer = Independent(model.A, model.B, model.C[:3], model.D[:3], model.Q, model.r[:3])
    blind = Independent(
        model.A,
        model.B,
        np.vstack([model.C[:3], np.zeros(2)]),
        np.vstack([model.D[:3], [0]]),
        model.Q,
        model.r,
    )
    y, u = record(model, 50, 80)
    noise = -0.5 * np.sum(y[:, 3] ** 2 / model.r[3] + np.log(2 * np.pi * model.r[3]))
    few, many = expect(fewer, Stack([(y[:, :3], u)])), expect(blind, Stack([(y, u)]))
    assert many.likelihood == pytest.approx(few.likelihood + noise, rel=1e-10)


def test_a_model_whose_covariance_does_not_reach_a_state_is_an_error_of_linear_algebra() -> None:
    model = random_model(9, n=2, m=1, q=0)
    dead = Independent(np.diag([0.5, 0.0]), model.B, model.C, model.D, np.diag([1.0, 0.0]), model.r)
    with pytest.raises(np.linalg.LinAlgError, match="reaches every state"):
        expect_with_gaps(dead, short(model, (5,), 1))

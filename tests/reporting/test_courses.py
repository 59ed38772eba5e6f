"""How much a sensor adds, and how that goes on, is what was added."""

import numpy as np
import pytest
from numpy.typing import NDArray

from securestate.reporting.courses import Course, Kind, course

Float = NDArray[np.float64]


def seen(values: Float, seed: int = 0) -> Course:
    """The course of values, seen with an error of standard deviation 1 from sample 50 on."""
    noisy = values + np.random.default_rng(seed).standard_normal(values.size)
    return course(50.0 + np.arange(values.size), noisy, channel="c", unit="kPa", noise=2.0, error=1.0)


K = np.arange(300.0)


@pytest.mark.parametrize("seed", range(10))
def test_a_bias_is_constant_with_its_size_and_scatter(seed: int) -> None:
    found = seen(np.full(300, -5.0), seed)
    assert (found.kind, found.slope, found.settled) == (Kind.CONSTANT, 0.0, None)
    assert found.last == pytest.approx(-5, abs=0.3) and found.size == -found.last
    assert found.spread == pytest.approx(1, abs=0.25) and found.clear
    assert found.in_noise == found.size / 2


@pytest.mark.parametrize("seed", range(10))
def test_a_ramp_grows_by_so_much_per_sample(seed: int) -> None:
    found = seen(0.1 * K, seed)
    assert found.kind is Kind.GROWING
    assert found.slope == pytest.approx(0.1, rel=0.05)
    assert (found.first, found.last) == (pytest.approx(0, abs=0.7), pytest.approx(29.9, abs=0.7))
    assert found.spread == pytest.approx(1, abs=0.25)


@pytest.mark.parametrize("seed", range(10))
def test_a_ramp_that_ends_settles_where_it_ends(seed: int) -> None:
    found = seen(0.1 * np.minimum(K, 100), seed)
    assert found.kind is Kind.SETTLING
    assert found.settled is not None and abs(found.settled - 150) <= 20
    assert found.last == pytest.approx(10, abs=0.4)


@pytest.mark.parametrize("values", [np.random.default_rng(1).normal(0, 6, 300), 6 * np.sin(K / 8)])
def test_what_changes_its_sign_is_erratic_and_its_size_is_a_root_mean_square(values: Float) -> None:
    found = seen(values)
    assert found.kind is Kind.ERRATIC
    assert found.size == pytest.approx(np.sqrt(np.mean(values**2) + 1), rel=0.1) and found.clear


def test_what_is_lost_in_its_scatter_is_not_clear() -> None:
    assert not seen(np.full(300, 0.3)).clear
    assert not seen(np.zeros(300)).clear


def test_of_a_few_estimates_only_the_size_is_told() -> None:
    found = seen(np.full(4, 7.0))
    assert found.kind is Kind.UNKNOWN and found.size == pytest.approx(7, abs=1)


def test_without_an_estimate_nothing_is_known() -> None:
    found = course(np.zeros(0), np.zeros(0), channel="c", unit="", noise=1.0, error=1.0)
    assert not found.known and not found.clear and found.in_noise == 0


def test_an_estimate_that_is_far_off_does_not_count() -> None:
    values = np.full(300, 5.0)
    values[[10, 150]] = 1e6
    found = seen(values)
    assert found.kind is Kind.CONSTANT and found.last == pytest.approx(5, abs=0.3)


def test_what_an_estimator_learns_of_a_constant_injection_is_no_growth() -> None:
    """Averages of more and more readings of 3 with an error of 1: at first off by about 1, later by 0.1."""
    rng = np.random.default_rng(4)
    k = np.arange(1, 201)
    values = np.cumsum(3.0 + rng.standard_normal(200)) / k
    values[:15] = np.linspace(2.2, 3.0, 15)
    sizes = {"channel": "flow", "unit": "m", "noise": 1.0, "error": 0.1}
    assert course(k.astype(float), values, **sizes).kind is Kind.SETTLING
    known = course(k.astype(float), values, **sizes, early=0.5)
    assert known.kind is Kind.CONSTANT and known.last == pytest.approx(3.0, abs=0.1)
    grown = course(k.astype(float), values + 0.02 * k, **sizes, early=0.5)
    assert grown.kind is Kind.GROWING and grown.slope == pytest.approx(0.02, rel=0.1)

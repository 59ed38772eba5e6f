"""The sensors without which least is left, against all sets."""

from itertools import combinations

import numpy as np
import pytest
from numpy.typing import NDArray

from securestate.resilience import _worst_set
from securestate.resilience._worst_set import worst_set

Array = NDArray[np.float64]


def left_of(X: Array, owner: NDArray[np.int64], removed: tuple[int, ...]) -> float:
    """min ||X_rest v|| / ||X v|| from the definition."""
    rest = X[~np.isin(owner, removed)]
    whole = np.linalg.inv(np.linalg.cholesky(X.conj().T @ X)).conj().T
    shares = np.linalg.svd(np.vstack([rest @ whole, np.zeros((X.shape[1], X.shape[1]))]), compute_uv=False)
    return float(shares[X.shape[1] - 1])


def case(seed: int) -> tuple[Array, NDArray[np.int64], int]:
    rng = np.random.default_rng(seed)
    g, sensors = int(rng.integers(1, 5)), int(rng.integers(4, 8))
    owner = np.repeat(np.arange(sensors), rng.integers(1, 3, sensors))
    X = rng.standard_normal((len(owner), g)) * 10.0 ** rng.uniform(-1, 1, (len(owner), 1))
    return (X + 1j * rng.standard_normal(X.shape) if seed % 3 == 0 else X), owner, sensors


@pytest.mark.parametrize("seed", range(30))
def test_the_set_is_the_worst_of_all(seed: int) -> None:
    X, owner, sensors = case(seed)
    allowed = np.random.default_rng(seed).random(sensors) < 0.8
    candidates = np.flatnonzero(allowed).tolist()
    for k in range(1, len(candidates) + 1):
        found = worst_set(X, owner, allowed, k)
        least = min(left_of(X, owner, chosen) for chosen in combinations(candidates, k))
        assert found.lower == found.upper
        np.testing.assert_allclose(found.upper, least, atol=2e-7)
        assert set(found.sensors) <= set(candidates)
        np.testing.assert_allclose(left_of(X, owner, tuple(found.sensors)), least, atol=2e-7)


@pytest.mark.parametrize("seed", range(30))
def test_bounds_enclose_the_worst_of_all_where_sets_are_too_many(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_worst_set, "BUDGET", 0)
    X, owner, sensors = case(seed)
    for k in range(1, sensors):
        found = worst_set(X, owner, np.ones(sensors, dtype=bool), k)
        least = min(left_of(X, owner, chosen) for chosen in combinations(range(sensors), k))
        assert found.lower - 2e-7 <= least <= found.upper + 2e-7
        np.testing.assert_allclose(left_of(X, owner, tuple(found.sensors)), found.upper, atol=2e-7)


def test_taking_nobody_away_leaves_all_and_a_blind_direction_leaves_nothing() -> None:
    X, owner = np.eye(3)[[0, 0, 1, 1]], np.arange(4)
    everybody = np.ones(4, dtype=bool)
    assert worst_set(X[:, :2], owner, everybody, 0).upper == 1.0
    assert worst_set(X, owner, everybody, 0).upper == 0.0  # nobody sees the third direction
    assert worst_set(X[:, :2], owner, everybody, 1).upper == pytest.approx(np.sqrt(0.5))
    assert worst_set(X[:, :2], owner, everybody, 2).upper == 0.0

"""The share of the worst sensors: against grids and linear programmes, bounds on their sides."""

from itertools import combinations

import numpy as np
import pytest
from numpy.typing import NDArray

from papers.liu2020.theorem4 import l1_ratio
from securestate.resilience import _share
from securestate.resilience._share import Attacked, Norms, bound_from_above, largest_share

Array = NDArray[np.float64]


def group_norms(seed: int, sensors: int, d: int, r: int = 2) -> Norms:
    rng = np.random.default_rng(seed)
    blocks = rng.standard_normal((sensors, r, d)) * 10.0 ** rng.uniform(-0.5, 0.5, (sensors, 1, 1))
    return Norms.of(list(blocks), range(sensors), sensors)


def anybody(sensors: int, count: int) -> Attacked:
    return Attacked(np.ones(sensors, dtype=bool), count)


def directions(d: int, count: int) -> Array:
    """Random directions and, in a plane, a fine grid."""
    if d == 2:
        angle = np.linspace(0, np.pi, count)
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.random.default_rng(0).standard_normal((count, d))


@pytest.mark.parametrize("sensors", [4, 9])
@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize("d", [1, 2, 3, 4])
def test_no_direction_has_a_larger_share_and_one_has_nearly_as_large_a_one(
    d: int, count: int, sensors: int
) -> None:
    norms, who = group_norms(d + 10 * count + sensors, sensors, d), anybody(sensors, count)
    found = largest_share(norms, who)
    lengths = norms.per_sensor(directions(d, 20_000))
    shares = np.sort(lengths, axis=1)[:, -count:].sum(axis=1) / lengths.sum(axis=1)
    assert shares.max() <= found.upper + 1e-12
    assert found.upper - found.lower <= 1e-3
    if d <= 2:
        assert found.lower >= shares.max() - 1e-9
    z = np.linalg.solve(norms.back, found.direction)
    own = norms.per_sensor(z[None])[0]
    np.testing.assert_allclose(own[found.sensors].sum() / own.sum(), found.lower, rtol=1e-9)


@pytest.mark.parametrize("seed", range(8))
def test_the_1_norm_gives_the_ratio_of_linear_programmes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    G = rng.standard_normal((5, 2, 3))
    norms = Norms.of([row[None] for sensor in G for row in sensor], np.repeat(np.arange(5), 2).tolist(), 5)
    for inside in combinations(range(5), 1 + seed % 2):
        found = largest_share(norms, Attacked.exactly(inside, 5), gap=1e-4)
        exact = l1_ratio(G, inside)
        share = 1.0 if np.isinf(exact) else exact / (1 + exact)
        assert found.lower <= share + 1e-9
        assert found.upper >= share - 1e-9
        assert found.upper - found.lower <= 1e-4


def test_the_worst_of_any_p_is_the_worst_of_all_sets() -> None:
    norms = group_norms(3, 6, 3)
    for count in (1, 2, 3):
        found = largest_share(norms, anybody(6, count), gap=1e-4)
        singles = [
            largest_share(norms, Attacked.exactly(I, 6), gap=1e-4) for I in combinations(range(6), count)
        ]
        assert max(one.lower for one in singles) <= found.upper + 1e-9
        assert max(one.upper for one in singles) >= found.lower - 1e-9


@pytest.mark.parametrize("d", [2, 4, 6, 12, 30])
def test_the_bound_from_above_is_above_what_an_ascent_reaches(d: int) -> None:
    for count in (1, 3):
        norms, who = group_norms(d, 40, d, r=3), anybody(40, count)
        found = largest_share(norms, who, time_limit=0.0)
        assert found.lower <= found.upper <= bound_from_above(norms, who) + 1e-12
        assert found.lower > count / 40  # the average direction


def test_deciding_stops_early_and_says_the_same() -> None:
    for seed in range(12):
        norms, who = group_norms(seed, 7, 3), anybody(7, 1 + seed % 3)
        quick, whole = largest_share(norms, who, decide=True), largest_share(norms, who)
        if whole.upper < 0.5 or whole.lower >= 0.5:
            assert (quick.upper < 0.5) == (whole.upper < 0.5)
            assert (quick.lower >= 0.5) == (whole.lower >= 0.5)


def test_cones_beyond_the_width_keep_their_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    norms, who = group_norms(5, 8, 4), anybody(8, 2)
    whole = largest_share(norms, who)
    monkeypatch.setattr(_share, "WIDTH", 7)
    narrow = largest_share(norms, who)
    assert narrow.lower <= whole.upper
    assert whole.lower <= narrow.upper
    assert narrow.upper - narrow.lower <= 1e-3
    monkeypatch.setattr(_share, "CONES", 20)
    cut = largest_share(norms, who)
    assert cut.lower <= whole.lower + 1e-12
    assert cut.upper >= whole.lower


def test_sensors_that_say_nothing_of_any_direction_change_nothing() -> None:
    rng = np.random.default_rng(9)
    blocks = [*rng.standard_normal((6, 2, 2)), np.zeros((2, 2)), np.zeros((1, 2))]
    norms = Norms.of(blocks, range(8), 8)
    found = largest_share(norms, anybody(8, 2))
    same = largest_share(Norms.of(blocks[:6], range(6), 6), anybody(6, 2))
    assert (found.lower, found.upper, found.factor) == pytest.approx((same.lower, same.upper, same.factor))
    assert set(found.sensors) <= set(range(6))


def test_nobody_attacked_has_no_share_and_everybody_all() -> None:
    norms = group_norms(1, 5, 3)
    assert largest_share(norms, anybody(5, 0)).upper == 0.0
    assert largest_share(norms, anybody(5, 5)).lower == pytest.approx(1.0)

import numpy as np
import pytest

from securestate.reporting.payload import pack, unpack


@pytest.mark.parametrize("delta", [False, True])
@pytest.mark.parametrize("finest", [0.0, 0.02])
def test_unpacking_is_within_half_a_step(delta: bool, finest: float) -> None:
    values = np.random.default_rng(3).standard_normal((500, 4)) * [1e-6, 1.0, 30.0, 1e9]
    block = pack(values, finest, delta=delta)
    error = np.abs(unpack(block) - values)
    assert np.all(error <= np.multiply(block.step, 0.5 + 1e-9))
    assert np.all(np.asarray(block.step) <= np.maximum(finest, np.ptp(values, axis=0) / 65534 * (1 + 1e-12)))


@pytest.mark.parametrize("delta", [False, True])
def test_what_is_not_finite_comes_back_as_nan_and_nothing_else_does(delta: bool) -> None:
    values = np.array([[np.nan, 1.0], [2.0, np.inf], [-3.0, -np.inf], [0.5, 4.0]])
    assert np.array_equal(np.isnan(unpack(pack(values, delta=delta))), ~np.isfinite(values))


def test_flags_and_small_integers_come_back_exactly() -> None:
    values = np.random.default_rng(4).integers(0, 4, (300, 3)).astype(np.float64)
    assert np.array_equal(unpack(pack(values, 1.0, delta=True)), values)


def test_constant_and_empty_columns_come_back_exactly() -> None:
    values = np.array([[7.25, np.nan], [7.25, np.nan]])
    assert np.array_equal(unpack(pack(values)), values, equal_nan=True)


def test_the_largest_jump_survives_differences() -> None:
    values = np.array([[-1.0], [1.0], [-1.0], [np.nan], [1.0]])
    assert np.allclose(unpack(pack(values, delta=True)), values, atol=1e-4, equal_nan=True)


def test_a_quarter_of_a_million_noise_values_take_less_than_two_bytes_each() -> None:
    values = np.random.default_rng(5).standard_normal((50_000, 5))
    assert len(pack(values, 0.02).text) < 2 * values.size

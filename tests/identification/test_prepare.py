"""What is done to a history before anything is fitted."""

import numpy as np
import pytest
from numpy.typing import NDArray

from securestate import MeasurementError, SecurestateWarning, identify
from securestate.identification import History
from securestate.identification.prepare import (
    LEAST_NOISE,
    STRETCH,
    Prepared,
    complete,
    prepare,
    rounding,
    split,
)

Array = NDArray[np.float64]
NAN = float("nan")


def noise(N: int, m: int, seed: int = 1) -> Array:
    return np.random.default_rng(seed).normal(size=(N, m))


def prepared(y: Array, u: Array | None = None, **names: list[str]) -> Prepared:
    return prepare(History.of(y, u, **names))


@pytest.mark.parametrize("step", [0.25, 0.01, 3.0])
@pytest.mark.parametrize("offset", [0.0, 20.13, -1e5])
def test_the_step_of_rounded_readings_is_found(step: float, offset: float) -> None:
    x = offset + step * np.round(noise(2000, 1)[:, 0] * 5)
    assert rounding(x) == pytest.approx(step, rel=1e-6)


def test_a_few_missing_readings_do_not_hide_the_step() -> None:
    x = np.round(noise(500, 1)[:, 0], 1)
    x[::7] = NAN
    assert rounding(x) == pytest.approx(0.1)


@pytest.mark.parametrize(
    "x",
    [
        noise(500, 1)[:, 0],
        np.full(50, 3.0),
        np.full(50, NAN),
        np.array([1.0]),
        np.round(noise(40, 1)[:, 0], 4),
        np.repeat(noise(30, 1)[:, 0], 10),
    ],
    ids=["continuous", "constant", "empty", "one", "too fine to tell", "held"],
)
def test_no_step_is_found_where_there_is_none(x: Array) -> None:
    assert rounding(x) == 0.0


def test_rounded_readings_have_at_least_the_noise_of_their_rounding() -> None:
    y = noise(1000, 2)
    y[:, 0] = 0.5 * np.round(y[:, 0] / 0.5)
    found = prepared(y)
    np.testing.assert_allclose(found.steps, [0.5, 0.0])
    np.testing.assert_allclose(found.floor, [0.25 / 12 / y[:, 0].var(), LEAST_NOISE])


def test_channels_are_normalised_by_their_mean_and_standard_deviation() -> None:
    y, u = 300 + [1.0, 50.0] * noise(400, 2), 7 * noise(400, 1, 2) + 40
    y[5, 0] = NAN
    found = prepared(y, u)
    np.testing.assert_allclose(found.offset, np.nanmean(y, axis=0))
    np.testing.assert_allclose(found.scale, np.nanstd(y, axis=0))
    [(z, v)] = found.segments
    np.testing.assert_allclose(z, (y - found.offset) / found.scale)
    assert (np.mean(v), np.std(v)) == pytest.approx((0, 1))
    other = History.of(2 * y, u)
    np.testing.assert_allclose(found.normalise(other)[0][0], (2 * y - found.offset) / found.scale)


def test_what_never_changes_or_holds_nothing_is_left_out_and_said() -> None:
    y, u = noise(200, 5), noise(200, 2, 2)
    y[:, 1], y[:, 2], y[:, 4], u[:, 0] = 7.0, NAN, 1e6, 5.0
    found = prepared(y, u, channel_names=list("abcde"), input_names=["held", "moves"])
    assert [group.channels for group in found.groups] == [(0,), (3,)]
    assert found.segments[0][0].shape == (200, 2)
    assert found.inputs.tolist() == [1]
    assert found.remarks == (
        "c holds no reading and is left out.",
        "b and e never change in the history and are left out.",
        "1 input without a change of its own left out: held.",
    )


def test_a_history_of_constant_channels_is_refused() -> None:
    with pytest.raises(
        MeasurementError, match="y: expected channels that vary, received constant channels only"
    ):
        prepared(np.tile([1.0, 2.0], (100, 1)))


def test_channels_that_repeat_each_other_are_one_mirrored_or_not_in_whatever_units() -> None:
    y = noise(300, 4)
    twin = 40 - 3 * y[:, [0]] + 1e-4 * noise(300, 1, 5)
    again = 1000 * y[:, [0]]
    again[3] = NAN
    found = prepared(np.hstack([y, twin, again]), channel_names=list("abcdef"))
    assert [group.channels for group in found.groups] == [(0, 4, 5), (1,), (2,), (3,)]
    assert found.groups[0].signs == (1.0, -1.0, 1.0)
    assert "a, e and f repeat each other and count as one sensor" in found.remarks[0]
    [(z, _)] = found.segments
    np.testing.assert_allclose(z[:, 0], (y[:, 0] - y[:, 0].mean()) / y[:, 0].std(), atol=0.02)


@pytest.mark.parametrize(("apart", "groups"), [(5e-4, 1), (0.01, 2)])
def test_channels_that_differ_by_more_than_a_thousandth_are_two(apart: float, groups: int) -> None:
    y = noise(1000, 1)
    assert len(prepared(np.hstack([y, y + apart * noise(1000, 1, 2)])).groups) == groups


def test_merged_channels_become_one_sensor_with_a_positive_definite_covariance_and_their_own_signs() -> None:
    x, e = np.zeros(1500), noise(1500, 4, 3)
    for k in range(1, 1500):
        x[k] = 0.9 * x[k - 1] + e[k, 0]
    y = x[:, None] + e[:, 1:]
    y = 50 + np.column_stack([y, -2 * y[:, 0], np.full(1500, 3.0)])
    names = ["a", "b", "c", "mirror", "dead"]
    with pytest.warns(SecurestateWarning, match="a and mirror repeat each other|dead never changes"):
        found = identify(y, order=1, channel_names=names)
    plant = found.plant
    assert plant.sensor_names == ("a + mirror", "b", "c")
    assert plant.channel_names == ("a", "mirror", "b", "c")
    assert len(found.remarks) == 2
    assert (found.channels, found.innovations.S.shape) == (("a", "b", "c"), (3, 3))
    assert np.linalg.eigvalsh(plant.R)[0] > 0
    np.testing.assert_allclose(plant.C[1], -plant.C[0], rtol=1e-12)
    assert plant.R[0, 1] < 0
    assert plant.R[0, 2] == plant.R[0, 3] == 0
    # A pair that says the same is worth one sensor: noise of one, 1, in engineering units.
    assert np.sqrt(plant.R[0, 0]) * plant.scale[0] == pytest.approx(1, rel=0.15)
    assert np.sqrt(plant.R[1, 1]) * plant.scale[1] == pytest.approx(2, rel=0.15)


def test_up_to_three_missing_samples_are_interpolated_and_four_cut_the_record() -> None:
    y = np.arange(60.0)[:, None] ** 2
    y[20:23], y[40:44] = NAN, NAN
    stretches = complete([(y, np.arange(60.0)[:, None])])
    assert [len(z) for z, _ in stretches] == [40, 16]
    filled, u = stretches[0]
    np.testing.assert_allclose(filled[19:24, 0], np.linspace(19**2, 23**2, 5))
    np.testing.assert_array_equal(np.delete(filled, np.s_[20:23]), np.delete(y[:40], np.s_[20:23]))
    np.testing.assert_array_equal(u[:, 0], np.arange(40))
    np.testing.assert_array_equal(stretches[1][0], y[44:])


def test_nothing_is_invented_before_the_first_and_after_the_last_reading_or_of_an_empty_channel() -> None:
    y = np.arange(40.0)[:, None]
    y[:2], y[-1] = NAN, NAN
    [(z, _)] = complete([(y, np.zeros((40, 0)))])
    np.testing.assert_array_equal(z, y[2:-1])
    assert complete([(np.full((40, 1), NAN), np.zeros((40, 0)))]) == []


def test_stretches_too_short_are_not_used() -> None:
    y = np.zeros((40, 1))
    y[STRETCH - 1 : STRETCH + 5] = NAN
    assert [len(z) for z, _ in complete([(y, np.zeros((40, 0)))])] == [40 - STRETCH - 5]


@pytest.mark.parametrize("lengths", [(100,), (40, 60, 100), (150, 50), (50, 150)])
def test_a_split_keeps_every_sample_once_and_in_order(lengths: tuple[int, ...]) -> None:
    total = sum(lengths)
    numbers = np.split(np.arange(float(total))[:, None], np.cumsum(lengths)[:-1])
    before, after = split([(part, -part) for part in numbers], 0.25)
    kept = [np.vstack([y for y, _ in parts])[:, 0] for parts in (before, after)]
    np.testing.assert_array_equal(np.concatenate(kept), np.arange(total))
    assert len(kept[1]) == total // 4
    assert all(np.array_equal(y, -u) for y, u in [*before, *after])


def test_a_split_drops_no_more_than_ends_too_short_to_use() -> None:
    before, after = split([(np.zeros((100 + i, 1)), np.zeros((100 + i, 0))) for i in (0, 1, 5)], 0.33)
    left = [len(y) for y, _ in before], [len(y) for y, _ in after]
    assert left == ([100, 101], [100])  # 305 samples, 5 of them too few to fit

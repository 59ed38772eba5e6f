"""Histories: what is put together, and mistakes that are named."""

from typing import Any

import numpy as np
import pandas as pd
import pytest

from securestate import InputError, MeasurementError, ShapeError
from securestate.identification import History

NAN = float("nan")
Y = np.arange(12.0).reshape(6, 2)
U = np.arange(6.0)[:, None]


def lengths(history: History) -> list[int]:
    return [len(y) for y, _ in history.segments]


def test_columns_of_a_table_are_channels_by_name() -> None:
    frame = pd.DataFrame(Y, columns=["flow", "level"])
    history = History.of(frame, pd.DataFrame(U, columns=["valve"]), dt=2.0, units=["l/s", "m"])
    assert (history.channel_names, history.input_names) == (("flow", "level"), ("valve",))
    assert (history.units, history.dt) == (("l/s", "m"), 2.0)
    np.testing.assert_array_equal(history.segments[0][0], Y)


def test_arrays_have_numbered_columns_and_no_sample_time() -> None:
    history = History.of(Y, U)
    assert (history.channel_names, history.input_names) == (("y1", "y2"), ("u1",))
    assert (history.units, history.dt, history.samples, history.missing) == (("", ""), None, 6, 0.0)


def test_a_history_is_taken_as_it_is() -> None:
    history = History.of(Y)
    assert History.of(history) is history


@pytest.mark.parametrize(
    "beside",
    [{"u": U}, {"dt": 2.0}, {"channel_names": ["a", "b"]}, {"units": ["m", "m"]}, {"input_names": []}],
)
def test_what_is_given_beside_a_history_is_refused_and_not_dropped(beside: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=f"{next(iter(beside))}: expected nothing beside a History"):
        History.of(History.of(Y), **beside)


def test_what_is_selected_comes_in_the_order_asked_for() -> None:
    history = History.of([Y, Y[:3]], [U, U[:3]], channel_names=["a", "b"], units=["m", "K"], dt=1.0)
    chosen = history.select(["b", "a"], [])
    assert (chosen.channel_names, chosen.units, chosen.input_names) == (("b", "a"), ("K", "m"), ())
    assert lengths(chosen) == [6, 3]
    np.testing.assert_array_equal(chosen.segments[1][0], Y[:3, ::-1])
    assert chosen.segments[1][1].shape == (3, 0)


@pytest.mark.parametrize(
    ("absent", "expected"),
    [([], [12]), ([0], [11]), ([4, 5, 6, 7], [4, 4]), ([0, 5, 6, 7, 8], [4, 3]), ([8, 9, 10, 11], [8])],
)
def test_more_than_three_samples_without_all_inputs_end_a_segment(
    absent: list[int], expected: list[int]
) -> None:
    y, u = np.vstack([Y, 10 + Y]), np.hstack([np.vstack([U, 10 + U])] * 2)
    u[absent, 1] = NAN
    history = History.of(y, u)
    assert (lengths(history), history.held) == (expected, 0)
    known = np.setdiff1d(np.arange(12), absent)
    np.testing.assert_array_equal(np.vstack([y for y, _ in history.segments]), y[known])
    np.testing.assert_array_equal(np.vstack([u for _, u in history.segments]), u[known])


def test_up_to_three_missing_inputs_keep_the_last_known_value_and_are_counted() -> None:
    u = np.hstack([U, U])
    u[2:5, 1] = NAN
    history = History.of(Y, u)
    assert (lengths(history), history.held) == ([6], 3)
    assert history.segments[0][1][:, 1].tolist() == [*U[:2, 0], *[U[1, 0]] * 3, U[5, 0]]


def test_missing_readings_are_counted_and_stay_where_they_are() -> None:
    y = Y.copy()
    y[1, 0] = y[2] = NAN
    history = History.of(y)
    assert lengths(history) == [6]
    assert history.missing == 3 / 12


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (
            {"y": [1.0, 2.0]},
            ShapeError,
            "y: expected shape (N, channels), or a list of such arrays, received shape (2",
        ),
        ({"y": Y, "u": U[:4]}, ShapeError, "u: expected 6 samples, as y has, received 4"),
        ({"y": [Y, Y], "u": [U]}, ShapeError, "u: expected 2 segments, as y has, received 1"),
        ({"y": [Y, Y], "u": [U, U[:3]]}, ShapeError, "u[1]: expected 6 samples, as y has, received 3"),
        ({"y": [Y, Y[:, :1]]}, ShapeError, "y[1]: expected shape (N, 2), received shape (6, 1)"),
        (
            {"y": np.where(Y == 5, np.inf, Y)},
            MeasurementError,
            "y: expected finite numbers up to 1e+100, NaN where missing, rece",
        ),
        ({"y": [Y, np.where(Y == 5, np.inf, Y)]}, MeasurementError, "received inf at [2, 1]"),
        ({"y": Y[:0]}, MeasurementError, "y: expected samples, received none"),
        ({"y": Y, "u": NAN * U}, MeasurementError, "y: expected samples, received none"),
        ({"y": [["a", "b"]]}, InputError, "y: expected an array of real numbers, received could not convert"),
        ({"y": Y, "dt": 0.0}, InputError, "dt: expected"),
        ({"y": Y, "channel_names": ["a"]}, InputError, "channel_names: expected"),
        ({"y": Y, "channel_names": ["a", "a"]}, InputError, "channel_names: expected names that differ"),
        ({"y": Y, "u": U, "input_names": ["a", "b"]}, InputError, "input_names: expected"),
        ({"y": Y, "units": ["m"]}, InputError, "units: expected"),
        (
            {"y": [pd.DataFrame(Y, columns=["a", "b"]), pd.DataFrame(Y, columns=["b", "a"])]},
            InputError,
            "y: expected the columns a, b in every segment, received b, a",
        ),
    ],
)
def test_a_mistake_names_argument_expected_and_received(
    arguments: dict[str, Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error) as caught:
        History.of(**arguments)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("channels", "inputs", "message"),
    [
        (["a", "c"], [], "y: expected a column 'c', received a, b"),
        (["a"], ["v"], "u: expected a column 'v', received no column"),
    ],
)
def test_a_column_that_is_not_there_is_named(channels: list[str], inputs: list[str], message: str) -> None:
    with pytest.raises(InputError) as caught:
        History.of(Y, channel_names=["a", "b"]).select(channels, inputs)
    assert message in str(caught.value)

"""Files of history: which column is what, where a segment ends, and what is refused with which words."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from securestate import History, MeasurementError, identify, read_history
from securestate._history_files import LONGEST_GAP, read_histories
from securestate.errors import InputError

ROOT = Path(__file__).resolve().parents[1]
nan = np.nan

Write = Callable[..., Path]


@pytest.fixture
def file(tmp_path: Path) -> Write:
    def write(*lines: str, name: str = "history.csv") -> Path:
        path = tmp_path / name
        path.write_text("\n".join(lines), encoding="utf-8")
        return path

    return write


def refused(path: object, **options: object) -> str:
    with pytest.raises(InputError) as caught:
        read_history(path, **options)  # type: ignore[arg-type]
    return str(caught.value)


def lengths(history: History) -> list[int]:
    return [len(y) for y, _ in history.segments]


def test_every_column_left_is_a_channel_in_the_order_of_the_file(file: Write) -> None:
    path = file("time,flow,valve,note,level", "0,1,5,ok,2", "2,3,6,,4")
    history = read_history(path, inputs=["valve"], ignore=["note"])
    assert (history.channel_names, history.input_names, history.dt) == (("flow", "level"), ("valve",), 2.0)
    [(y, u)] = history.segments
    np.testing.assert_array_equal(y, [[1, 2], [3, 4]])
    np.testing.assert_array_equal(u, [[5], [6]])


def test_a_column_without_a_name_is_no_channel(file: Write) -> None:
    assert read_history(file("a,b,", "1,2,", "3,4,")).channel_names == ("a", "b")
    numbered = file(",a,b", "0,1,2", "1,3,4")
    assert read_history(numbered, ignore=["(column 1: no name)"]).channel_names == ("a", "b")


def test_named_channels_come_in_their_order_and_other_columns_are_not_read(file: Write) -> None:
    history = read_history(file("flow,note,level", "1,ok,2", "3,,4"), channels=["level", "flow"])
    np.testing.assert_array_equal(history.segments[0][0], [[2, 1], [4, 3]])
    assert (history.channel_names, history.input_names, history.dt) == (("level", "flow"), (), 1.0)


@pytest.mark.parametrize(
    ("times", "dt"),
    [
        (("0", "0.1", "0.2", "0.3"), 0.1),
        (("0.000", "0.333", "0.667", "1.000"), 0.333333),
        (("2024-01-01T00:00:00Z", "2024-01-01T00:00:30Z", "2024-01-01T00:01:30Z"), 30.0),
        (("2024-01-01 00:00", "2024-01-01 00:15", "2024-01-01 00:30"), 900.0),
        (("5", "10", "20"), 5.0),
    ],
)
def test_the_time_between_samples_is_the_usual_one_between_rows(
    file: Write, times: tuple[str, ...], dt: float
) -> None:
    assert read_history(file("time,a", *(f"{time},1" for time in times))).dt == dt


def test_a_long_record_does_not_drift_off_its_own_grid(file: Write) -> None:
    history = read_history(file("time,a", *(f"{k / 3:.3f},{k}" for k in range(3000))))
    assert lengths(history) == [3000]
    assert history.missing == 0


def test_dt_that_is_given_decides_and_fills_in_what_lies_between(file: Write) -> None:
    history = read_history(file("time,a", "0,1", "2,3", "4,5"), dt=1.0)
    np.testing.assert_array_equal(history.segments[0][0][:, 0], [1, nan, 3, nan, 5])
    assert read_history(file("a", "1", "2"), dt=60.0).dt == 60.0


def test_rows_that_lack_in_the_grid_are_missing_and_a_long_gap_begins_a_segment(file: Write) -> None:
    short, long = LONGEST_GAP + 1, LONGEST_GAP + 2
    times = [0, 1, 2, 2 + short, 3 + short, 3 + short + long, 4 + short + long]
    history = read_history(file("time,a", *(f"{time},7" for time in times)))
    assert lengths(history) == [4 + short, 2]
    assert np.isnan(history.segments[0][0]).sum() == LONGEST_GAP
    assert not np.isnan(history.segments[1][0]).any()


def test_a_segment_after_a_long_gap_has_a_grid_of_its_own(file: Write) -> None:
    history = read_history(file("time,a", "0,1", "1,2", "2,3", "100.4,4", "101.4,5"))
    assert lengths(history) == [3, 2]


def test_the_segment_column_splits_and_time_may_start_again(file: Write) -> None:
    rows = ["a,0,1", "a,1,2", "b,0,3", "b,1,4", "b,2,5", "a,0,6"]
    history = read_history(file("run,time,flow", *rows), segment_column="run")
    assert history.channel_names == ("flow",)
    assert lengths(history) == [2, 3, 1]
    numbered = [row.replace("a", "1.5").replace("b", "2") for row in rows]
    assert lengths(read_history(file("run,time,flow", *numbered), segment_column="run")) == [2, 3, 1]


def test_runs_of_the_example_are_its_segments() -> None:
    history = read_history(ROOT / "examples/tennessee-eastman/history.csv", segment_column="run")
    frame = pd.read_csv(ROOT / "examples/tennessee-eastman/history.csv")
    assert history.dt == 180.0
    assert history.channel_names == tuple(frame.columns[2:])
    for (y, _), (_, part) in zip(history.segments, frame.groupby("run", sort=False), strict=True):
        np.testing.assert_array_equal(y, part.iloc[:, 2:])


def test_inputs_that_miss_more_than_three_samples_end_a_segment_and_fewer_are_held(file: Write) -> None:
    rows = ["0,1,1", "1,2,2", "2,3,", "3,4,", "4,5,", "5,6,1", "6,7,", "7,8,", "8,9,", "9,10,", "10,11,5"]
    history = read_history(file("time,a,u", *rows), inputs=["u"])
    assert [y[:, 0].tolist() for y, _ in history.segments] == [[1, 2, 3, 4, 5, 6], [11]]
    assert history.segments[0][1][:, 0].tolist() == [1, 2, 2, 2, 2, 1]
    assert history.held == 3


def test_every_file_is_a_segment_of_its_own(file: Write) -> None:
    first = file("time,a,b", "0,1,2", "1,3,4", name="first.csv")
    second = file("b;time;a", "6,5;0;5,5", "8,5;1;7,5", name="second.csv")
    history = read_history([first, second])
    assert history.channel_names == ("a", "b")
    np.testing.assert_array_equal(history.segments[1][0], [[5.5, 6.5], [7.5, 8.5]])


@pytest.mark.parametrize("suffix", [".csv", ".tsv", ".txt", ".parquet", ".nc"])
def test_every_kind_of_file_holds_the_same_history(tmp_path: Path, suffix: str) -> None:
    frame = pd.DataFrame({"time": [0.0, 0.5, 1.5], "flow": [1.5, nan, 2.5], "valve": [1.0, 2.0, 3.0]})
    path = tmp_path / f"history{suffix}"
    if suffix == ".parquet":
        frame.to_parquet(path)
    elif suffix == ".nc":
        frame.set_index("time").to_xarray().to_netcdf(path, engine="h5netcdf")
    else:
        frame.to_csv(path, sep="\t" if suffix == ".tsv" else ";", decimal=",", index=False)
    history = read_history(path)
    assert (history.channel_names, history.dt) == (("flow", "valve"), 0.5)
    np.testing.assert_array_equal(history.segments[0][0], [[1.5, 1], [nan, 2], [nan, nan], [2.5, 3]])


def test_segment_and_ignored_columns_need_to_be_in_one_file_only(file: Write) -> None:
    runs = file("run,time,a,note", "1,0,1,x", "1,1,2,x", "2,0,3,x", name="runs.csv")
    plain = file("time,a", "0,1", "1,2", name="plain.csv")
    one, other = read_histories([plain, runs], ignore=["note"], segment_column="run")
    assert (lengths(one), lengths(other)) == ([2], [2, 1])


def test_the_history_is_what_identify_takes(file: Write) -> None:
    rng = np.random.default_rng(3)
    rows = [",".join(f"{cell:.4f}" for cell in row) for row in rng.normal(size=(80, 2))]
    found = identify(read_history(file("left,right", *rows), dt=5.0), order=1)
    assert (found.plant.channel_names, found.plant.dt, found.samples) == (("left", "right"), 5.0, 80)


@pytest.mark.parametrize(
    ("lines", "options", "message"),
    [
        (("a,b", "1,2"), {"inputs": ["B1"]}, "history.csv: expected a column for each of 'B1'"),
        (("flow,level", "1,2"), {"inputs": ["Flaw"]}, "(perhaps 'flow' for 'Flaw')"),
        (("flow,level", "1,2"), {"ignore": ["levle"]}, "(perhaps 'level' for 'levle')"),
        (("flow,level", "1,2"), {"channels": ["flow", "levels"]}, "(perhaps 'level' for 'levels')"),
        (("runs,level", "1,2"), {"segment_column": "run"}, "(perhaps 'runs' for 'run')"),
        (("times,level", "1,2"), {"time_column": "time"}, "(perhaps 'times' for 'time')"),
        (
            ("a,note", "1,ok", "2,"),
            {},
            "history.csv, line 2, column 'note': expected a number or an empty cell",
        ),
        (("a,note", "1,ok"), {}, "name it in ignore, segment_column or time_column), received 'ok'"),
        (("a,b", "1,x"), {"channels": ["b"]}, "expected a number or an empty cell, received 'x'"),
        (("a,b", "1,x"), {"inputs": ["b"]}, "expected a number or an empty cell, received 'x'"),
        (
            (",a,b", "0,1,2"),
            {},
            "expected a name for every column, or ignore for one without, received '(column 1",
        ),
        (("a,b", "1,inf"), {}, "expected a finite number or an empty cell"),
        (
            ("time,a", "0,1", "1,1", "0,1"),
            {},
            "line 4, column 'time': expected a time after 1.0, or a segment",
        ),
        (("time,a", "0,1", "1,1", "2.4,1", "3,1"), {}, "line 4, column 'time': expected the first time"),
        (
            ("run,time,a", "1,0,1", "1,1,1", "2,0,1", "2,1.5,1"),
            {"segment_column": "run"},
            "line 5, column 'time': expected the first time, 0.0, plus a multiple of 1 s",
        ),
        (
            ("run,a", "1,1", ",1"),
            {"segment_column": "run"},
            "line 3, column 'run': expected a value in every row",
        ),
        (("time,a", "0,1"), {}, "column 'time': expected at least two times, or dt given, received one"),
        (("time,u", "0,1"), {"inputs": ["u"]}, "expected a column that is a channel"),
        (("a,b", "1,2"), {"inputs": ["a"], "ignore": ["a"]}, "ignore: expected other columns than inputs"),
        (("a,b", "1,2"), {"inputs": ["a", "a"]}, "inputs: expected names that differ"),
        (("a,b", "1,2"), {"inputs": "a"}, "inputs: expected a list of text"),
        (("a,b", "1,2"), {"channels": []}, "channels: expected at least one name"),
        (("a,b", "1,2"), {"dt": 0}, "dt: expected one number > 0"),
        (("a,u", "1,", "2,"), {"inputs": ["u"]}, "inputs: expected a sample with all inputs"),
    ],
)
def test_what_cannot_be_meant_is_refused_with_its_place(
    file: Write, lines: tuple[str, ...], options: dict[str, object], message: str
) -> None:
    assert message in refused(file(*lines), **options)


def test_files_that_do_not_fit_each_other_are_refused(file: Write) -> None:
    first = file("time,flow,level", "0,1,2", "1,1,2", name="first.csv")
    less = file("time,flow", "0,1", name="less.csv")
    more = file("time,flow,level,extra", "0,1,2,3", name="more.csv")
    slower = file("time,flow,level", "0,1,2", "1.5,1,2", name="slower.csv")
    assert "less.csv: expected a column for each of 'level'" in refused([first, less])
    assert "more.csv: expected the columns of first.csv, received 'extra' too" in refused([first, more])
    assert "slower.csv, line 3, column 'time': expected the first time" in refused([first, slower])
    assert "path: expected a file, or a list of files" in refused([])
    with pytest.raises(MeasurementError, match=r"nothing\.csv: expected a readable file"):
        read_history([first, first.with_name("nothing.csv")])

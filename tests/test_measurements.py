"""What a measurement file may look like, what comes out of it, and what is refused with which words."""

import os
import stat
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as parquet
import pytest
import xarray as xr
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import securestate as ss
from securestate.errors import InputError, MeasurementError, SecurestateError
from securestate.estimators import KalmanFilter, Run
from securestate.measurements import Measurements, read_measurements, write_run

PLAIN = ss.Plant(
    A=[[1.0]],
    Q=[[0.1]],
    sensors=[ss.Sensor("flow 1", C=[[1.0]], R=1.0), ss.Sensor("level", C=[[2.0]], R=1.0)],
)
DRIVEN = ss.Plant(A=[[0.9]], B=[[1.0]], Q=[[0.1]], sensors=PLAIN.sensors, dt=0.5, input_names=["valve"])
nan = np.nan

Write = Callable[[str | bytes], Path]


@pytest.fixture
def csv_file(tmp_path: Path) -> Write:
    def write(content: str | bytes) -> Path:
        path = tmp_path / "data.csv"
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return write


def refused(path: Path, plant: ss.Plant = PLAIN, **options: object) -> MeasurementError:
    with pytest.raises(MeasurementError) as caught:
        read_measurements(path, plant, **options)  # type: ignore[arg-type]
    assert path.name in str(caught.value)
    return caught.value


def test_columns_are_matched_by_name_in_any_order_and_extra_ones_are_reported(csv_file: Write) -> None:
    read = read_measurements(csv_file("level,note,time, flow 1 \n20,ok,0,10\n21,,1,11\n"), PLAIN)
    np.testing.assert_array_equal(read.y, [[10, 20], [11, 21]])
    np.testing.assert_array_equal(read.time, [0.0, 1.0])
    assert read.extra == ("note",)
    assert (read.absent, read.gaps, read.held, read.u) == ((), 0, 0, None)


def test_without_a_time_column_rows_are_consecutive_samples(csv_file: Write) -> None:
    read = read_measurements(csv_file("flow 1,level\n1,2\n3,4\n"), PLAIN)
    assert read.time is None
    np.testing.assert_array_equal(read.y, [[1, 2], [3, 4]])


@pytest.mark.parametrize("cell", ["", " ", "NaN", "nan", "NA", "n/a", "null", "NULL", '""'])
def test_every_spelling_of_a_missing_cell_is_nan(csv_file: Write, cell: str) -> None:
    read = read_measurements(csv_file(f"flow 1,level\n1,{cell}\n{cell},4\n"), PLAIN)
    np.testing.assert_array_equal(read.y, [[1, nan], [nan, 4]])


@pytest.mark.parametrize("cell", ["+1.5", "1.5", "15e-1", ".15E+1", "1.50", " 1.5 "])
def test_numbers_are_read_in_every_common_notation(csv_file: Write, cell: str) -> None:
    assert read_measurements(csv_file(f"flow 1,level\n{cell},2.\n"), PLAIN).y.tolist() == [[1.5, 2.0]]


def test_numbers_come_back_bit_for_bit(csv_file: Write) -> None:
    numbers = np.random.default_rng(1).standard_normal((500, 2)) * 10.0 ** np.arange(-250, 250)[:, None]
    text = "flow 1,level\n" + "".join(f"{a!r},{b!r}\n" for a, b in numbers.tolist())
    np.testing.assert_array_equal(read_measurements(csv_file(text), PLAIN).y, numbers)


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_line_ends_byte_order_mark_and_quotes_do_not_matter(csv_file: Write, end: str) -> None:
    text = "\ufeff" + end.join(['"flow 1","level"', "1,2", '3,"4"', "", ""])
    np.testing.assert_array_equal(read_measurements(csv_file(text), PLAIN).y, [[1, 2], [3, 4]])


@pytest.mark.parametrize("separator", [";", "\t"])
def test_semicolons_and_tabs_are_told_from_the_header(csv_file: Write, separator: str) -> None:
    text = "a,b;flow 1;level\n1;2.5;3\n".replace(";", separator)
    read = read_measurements(csv_file(text), PLAIN)
    assert read.y.tolist() == [[2.5, 3.0]]
    assert read.extra == ("a,b",)


def test_decimal_commas_are_read_where_no_other_reading_is_possible(csv_file: Write) -> None:
    read = read_measurements(csv_file("time;flow 1;level\n0;0,5;1,234\n1;-12,25;,5\n"), PLAIN)
    assert read.y.tolist() == [[0.5, 1.234], [-12.25, 0.5]]


@pytest.mark.parametrize("rows", ["1,234;2\n", "0,5;2.5\n"])
def test_a_comma_that_may_mean_thousands_or_decimals_is_refused(csv_file: Write, rows: str) -> None:
    error = refused(csv_file("flow 1;level\n" + rows))
    assert (error.argument, error.expected) == (
        "data.csv, line 2, column 'flow 1'",
        "a number or an empty cell",
    )


def test_a_semicolon_file_is_known_by_names_with_commas_in_them(csv_file: Write) -> None:
    sensors = [ss.Sensor("flow, upper", C=[[1.0]], R=1.0), ss.Sensor("flow, lower", C=[[1.0]], R=1.0)]
    plant = ss.Plant(A=[[1.0]], Q=[[0.1]], sensors=sensors)
    assert read_measurements(csv_file("flow, upper;flow, lower\n1;2\n"), plant).y.tolist() == [[1.0, 2.0]]
    assert read_measurements(csv_file('"flow, upper","flow, lower"\n1,2\n'), plant).y.tolist() == [[1.0, 2.0]]


def test_missing_columns_are_all_named_with_near_misses(csv_file: Write) -> None:
    error = refused(csv_file("time,Flow1,lvel,valve\n0,1,2,3\n"), DRIVEN)
    assert error.expected == "a column for each of 'flow 1', 'level'"
    assert "'Flow1' for 'flow 1'" in error.received
    assert "'lvel' for 'level'" in error.received


def test_missing_columns_may_be_allowed_and_are_then_listed(csv_file: Write) -> None:
    read = read_measurements(csv_file("level\n1\n2\n"), PLAIN, allow_missing=True)
    np.testing.assert_array_equal(read.y, [[nan, 1], [nan, 2]])
    assert read.absent == ("flow 1",)


def test_a_file_without_any_channel_is_refused_even_if_missing_ones_are_allowed(csv_file: Write) -> None:
    assert "at least one channel" in refused(csv_file("pressure\n1\n"), allow_missing=True).expected


def test_a_missing_input_column_is_refused_even_if_missing_channels_are_allowed(csv_file: Write) -> None:
    assert "'valve'" in refused(csv_file("flow 1,level\n1,2\n"), DRIVEN, allow_missing=True).expected


def test_gaps_become_rows_of_nan_on_the_grid(csv_file: Write) -> None:
    read = read_measurements(csv_file("time,flow 1,level\n10,1,2\n11,3,4\n14,5,6\n"), PLAIN)
    np.testing.assert_array_equal(read.y, [[1, 2], [3, 4], [nan, nan], [nan, nan], [5, 6]])
    np.testing.assert_array_equal(read.time, [10, 11, 12, 13, 14])
    assert read.gaps == 2


def test_jitter_is_rounded_and_rows_keep_their_own_times(csv_file: Write) -> None:
    read = read_measurements(csv_file("time,flow 1,level\n0,1,2\n1.009,3,4\n2.991,5,6\n"), PLAIN)
    np.testing.assert_array_equal(read.y[:, 0], [1, 3, nan, 5])
    np.testing.assert_array_equal(read.time, [0, 1.009, 2, 2.991])


def test_the_row_that_lies_worst_off_the_grid_is_named(csv_file: Write) -> None:
    error = refused(csv_file("time,flow 1,level\n0,1,2\n1.02,3,4\n2.3,5,6\n3,7,8\n"))
    assert error.argument == "data.csv, line 4, column 'time'"
    assert "multiple of 1 s" in error.expected
    assert "2.3" in error.received


@pytest.mark.parametrize(("first", "second"), [("1", "1"), ("2", "1"), ("1", "1.001")])
def test_time_must_increase_to_another_sample(csv_file: Write, first: str, second: str) -> None:
    error = refused(csv_file(f"time,flow 1,level\n0,1,2\n{first},3,4\n{second},5,6\n"))
    assert error.argument == "data.csv, line 4, column 'time'"
    assert float(second) == float(error.received.split()[0])


@pytest.mark.parametrize(
    ("cells", "times"),
    [
        (
            ["2024-03-01T00:00:00Z", "2024-03-01T01:00:01+01:00"],
            ["2024-03-01T00:00:00", "2024-03-01T00:00:01"],
        ),
        (
            ["2024-03-01 00:00:00.5", "2024-03-01 00:00:01.5"],
            ["2024-03-01T00:00:00.5", "2024-03-01T00:00:01.5"],
        ),
        (["1960-01-01 00:00", "1960-01-01 00:00:01"], ["1960-01-01T00:00:00", "1960-01-01T00:00:01"]),
    ],
)
def test_iso_times_become_utc_instants(csv_file: Write, cells: list[str], times: list[str]) -> None:
    read = read_measurements(csv_file(f"time,flow 1,level\n{cells[0]},1,2\n{cells[1]},3,4\n"), PLAIN)
    assert read.time is not None
    assert read.time.dtype == np.dtype("datetime64[ns]")
    np.testing.assert_array_equal(read.time, np.array(times, "datetime64[ns]"))


def test_a_gap_between_iso_times_gets_times_of_the_grid(csv_file: Write) -> None:
    text = "time,flow 1,level,valve\n2024-03-01T00:00:00,1,2,0\n2024-03-01T00:00:01.5,3,4,1\n"
    read = read_measurements(csv_file(text), DRIVEN, hold_inputs=True)
    expected = np.datetime64("2024-03-01", "ns") + np.arange(4) * np.timedelta64(500, "ms")
    np.testing.assert_array_equal(read.time, expected)


@pytest.mark.parametrize(
    "second",
    [
        "2024-02-30T00:00:00",
        "yesterday",
        "2024-01-01T00:00:01Z",
        "12",
        "",
        "9999-01-01T00:00:00",
        "2024-01-01T25:00",
    ],
)
def test_a_time_that_does_not_fit_the_first_is_named(csv_file: Write, second: str) -> None:
    error = refused(csv_file(f"time,flow 1,level\n2024-01-01T00:00:00,1,2\n{second},3,4\n"))
    assert error.argument == "data.csv, line 3, column 'time'"
    assert second in error.received or error.received == "an empty cell"


@pytest.mark.parametrize("second", ["", "inf", "2024-01-01T00:00:01", "nan"])
def test_seconds_must_be_finite_numbers_in_every_row(csv_file: Write, second: str) -> None:
    error = refused(csv_file(f"time,flow 1,level\n0,1,2\n{second},3,4\n"))
    assert error.argument == "data.csv, line 3, column 'time'"


def test_the_time_column_is_found_in_any_case_or_by_its_given_name(csv_file: Write) -> None:
    path = csv_file("TIME,stamp,flow 1,level\n0,5,1,2\n1,7,3,4\n")
    assert read_measurements(path, PLAIN).gaps == 0
    named = read_measurements(path, PLAIN, time_column="stamp")
    assert named.gaps == 1
    assert named.extra == ("TIME",)
    assert refused(path, time_column="stmp").expected == "the time column 'stmp'"
    assert "one time column" in refused(csv_file("TIME,time,flow 1,level\n0,5,1,2\n")).expected


@pytest.mark.parametrize("years", ["2206-01-01T00:00:00", "2024-02-01T00:00:00"])
def test_a_gap_of_absurd_size_is_refused_instead_of_filled(csv_file: Write, years: str) -> None:
    error = refused(csv_file(f"time,flow 1,level\n2024-01-01T00:00:00,1,2\n{years},3,4\n"))
    assert "span at most 1000000 samples" in error.expected
    assert error.argument == "data.csv, line 3, column 'time'"


def test_times_beyond_every_grid_are_refused(csv_file: Write) -> None:
    assert "span" in refused(csv_file("time,flow 1,level\n-1e308,1,2\n1e308,3,4\n")).expected


def test_inputs_are_read_beside_the_channels(csv_file: Write) -> None:
    read = read_measurements(csv_file("time,valve,flow 1,level\n0,7,1,2\n.5,8,3,4\n"), DRIVEN)
    assert read.u is not None
    np.testing.assert_array_equal(read.u, [[7], [8]])
    assert (read.held, read.extra) == (0, ())


def test_an_unknown_input_is_refused_unless_holding_is_asked_for(csv_file: Write) -> None:
    gap = csv_file("time,valve,flow 1,level\n0,7,1,2\n1,8,3,4\n")
    assert refused(gap, DRIVEN).argument == "data.csv, line 3"
    assert "hold_inputs" in refused(gap, DRIVEN).expected
    held = read_measurements(gap, DRIVEN, hold_inputs=True)
    assert (held.u.tolist() if held.u is not None else None, held.held) == ([[7.0], [7.0], [8.0]], 1)
    cell = csv_file("valve,flow 1,level\n7,1,2\n,3,4\n8,5,6\n")
    assert refused(cell, DRIVEN).argument == "data.csv, line 3, column 'valve'"
    held = read_measurements(cell, DRIVEN, hold_inputs=True)
    assert (held.u.tolist() if held.u is not None else None, held.held) == ([[7.0], [7.0], [8.0]], 1)
    first = csv_file("valve,flow 1,level\n,1,2\n8,3,4\n")
    assert refused(first, DRIVEN, hold_inputs=True).argument == "data.csv, line 2, column 'valve'"


@pytest.mark.parametrize("cell", ["inf", "-Infinity", "1e999"])
def test_an_infinite_measurement_is_refused_with_its_place(csv_file: Write, cell: str) -> None:
    error = refused(csv_file(f"flow 1,level\n1,2\n3,{cell}\n"))
    assert error.argument == "data.csv, line 3, column 'level'"
    assert (error.expected, error.received) == ("a finite number or an empty cell", repr(cell))


@pytest.mark.parametrize("cell", ["bad", "1 2", "0x10", "1_000", "--1", "1e", "True", "12 m", "\u0661"])
def test_text_among_numbers_is_refused_with_its_place(csv_file: Write, cell: str) -> None:
    error = refused(csv_file(f"flow 1,level\n1,2\n3,{cell}\n"))
    assert error.argument == "data.csv, line 3, column 'level'"
    assert error.received == repr(cell)


def test_a_long_text_is_cut_and_control_characters_are_escaped(csv_file: Write) -> None:
    error = refused(csv_file("flow 1,level\n1,\x1b[31m" + "x" * 5000 + "\n"))
    assert len(error.received) <= 60
    assert "\x1b" not in error.received


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "a file of measurements"),
        (b" \n\n", "a file of measurements"),
        (b"flow 1,level\n", "at least one row of measurements"),
        (b"flow 1,level,level\n1,2,3\n", "columns with names that differ"),
        (b"flow 1,level\n1,2,3\n", "2 cells as in the header"),
        (b"flow 1,level\n1,2\n3\n", "2 cells as in the header"),
        ("flow 1,level\n1,2\n".encode("utf-16"), "UTF-8 text"),
        (b"flow 1,l\xe9vel\n1,2\n", "UTF-8 text"),
        (b"flow 1,level\n1,\xe9\n", "UTF-8 text"),
        (b'flow 1,level,note\n1,2,"\n3,4,b\n', "one line per row"),
        (b'flow 1,"level\n1,2\n', "names of columns"),
    ],
)
def test_a_damaged_text_file_is_refused_with_the_reason(
    csv_file: Write, content: bytes, expected: str
) -> None:
    assert refused(csv_file(content)).expected == expected


def test_a_row_with_too_few_cells_is_named(csv_file: Write) -> None:
    error = refused(csv_file("flow 1,level\n1,2\n3,4\n5\n"))
    assert (error.argument, error.received) == ("data.csv, line 4", "1")


def test_columns_without_a_name_are_extra_columns(csv_file: Write) -> None:
    read = read_measurements(csv_file(",flow 1,level,\n0,1,2,\n1,3,4,\n"), PLAIN)
    assert read.extra == ("(column 1: no name)", "(column 4: no name)")


@pytest.mark.parametrize("name", ["data.xlsx", "data", "none.csv", "folder.csv"])
def test_a_file_that_cannot_be_read_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "data.xlsx").write_text("x")
    (tmp_path / "data").write_text("x")
    (tmp_path / "folder.csv").mkdir()
    refused(tmp_path / name)


def frame() -> pd.DataFrame:
    return pd.DataFrame(
        {"time": [0, 1, 3], "flow 1": [1.0, nan, 5.0], "level": [2, 4, 6], "note": ["a", None, "c"]}
    )


def check_frame(read: Measurements) -> None:
    np.testing.assert_array_equal(read.y, [[1, 2], [nan, 4], [nan, nan], [5, 6]])
    np.testing.assert_array_equal(read.time, [0, 1, 2, 3])
    assert (read.extra, read.gaps) == (("note",), 1)


def test_parquet_says_the_same_as_csv(tmp_path: Path) -> None:
    frame().to_parquet(tmp_path / "data.parquet")
    frame().to_csv(tmp_path / "data.csv", index=False)
    check_frame(read_measurements(tmp_path / "data.parquet", PLAIN))
    check_frame(read_measurements(tmp_path / "data.csv", PLAIN))


def test_netcdf_with_one_variable_per_channel_says_the_same(tmp_path: Path) -> None:
    frame().fillna({"note": ""}).set_index("time").to_xarray().to_netcdf(
        tmp_path / "data.nc", engine="h5netcdf"
    )
    check_frame(read_measurements(tmp_path / "data.nc", PLAIN))


def test_netcdf_with_labelled_columns_and_classic_netcdf_are_read(tmp_path: Path) -> None:
    time = np.array(["2024-01-01T00:00:00", "2024-01-01T00:00:01"], "datetime64[ns]")
    table = xr.Dataset(
        {"y": (("tag", "time"), [[1.0, 3.0], [2.0, nan]])}, {"time": time, "tag": ["flow 1", "level"]}
    )
    for engine, name in (("h5netcdf", "new.nc"), ("scipy", "classic.nc")):
        table.to_netcdf(tmp_path / name, engine=engine)  # type: ignore[call-overload]
        read = read_measurements(tmp_path / name, PLAIN)
        np.testing.assert_array_equal(read.y, [[1, 2], [3, nan]])
        np.testing.assert_array_equal(read.time, time)


def test_parquet_instants_with_a_zone_become_utc(tmp_path: Path) -> None:
    stamps = pd.date_range("2024-07-01", periods=2, freq="s", tz="Europe/Berlin")
    pd.DataFrame({"time": stamps, "flow 1": [1, 2], "level": [3, 4]}).to_parquet(tmp_path / "data.parquet")
    read = read_measurements(tmp_path / "data.parquet", PLAIN)
    assert read.time is not None
    assert read.time[0] == np.datetime64("2024-06-30T22:00:00")


@pytest.mark.parametrize(
    "values", [pa.array([True, False]), pa.array([[1], [2]]), pa.array(["1", "x"]), pa.array([1.0, np.inf])]
)
def test_parquet_columns_that_are_no_finite_numbers_are_refused(tmp_path: Path, values: pa.Array) -> None:
    parquet.write_table(pa.table({"flow 1": values, "level": [1.0, 2.0]}), tmp_path / "data.parquet")
    assert "column 'flow 1'" in refused(tmp_path / "data.parquet").argument


def test_parquet_with_columns_twice_or_no_rows_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "data.parquet"
    parquet.write_table(pa.table([[1.0], [2.0]], names=["level", "level "]), path)
    assert refused(path).expected == "columns with names that differ"
    parquet.write_table(
        pa.table({"flow 1": pa.array([], pa.float64()), "level": pa.array([], pa.float64())}), path
    )
    assert refused(path).expected == "at least one row of measurements"


@pytest.fixture(scope="module")
def seeds(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    tmp = tmp_path_factory.mktemp("seeds")
    frame().to_parquet(tmp / "seed.parquet")
    frame().drop(columns="note").set_index("time").to_xarray().to_netcdf(tmp / "seed.nc", engine="h5netcdf")
    (tmp / "seed.csv").write_bytes(
        b'time,flow 1,level,note\n0,1,2,a\n1,,4.5e-3,\xc3\xa9\n2,5,6,\n3,1;2,"x"\n'
    )
    return {path.suffix: path.read_bytes() for path in tmp.iterdir()}


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".nc"])
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_mutated_file_is_measurements_or_a_plain_refusal(
    tmp_path: Path, seeds: dict[str, bytes], suffix: str, data: st.DataObject
) -> None:
    content = bytearray(seeds[suffix])
    for _ in range(data.draw(st.integers(0, 4))):
        at = data.draw(st.integers(0, len(content)))
        content[at : at + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=3))
    path = tmp_path / f"fuzz{suffix}"
    path.write_bytes(content)
    try:
        read = read_measurements(path, PLAIN, allow_missing=True)
    except SecurestateError:
        return
    assert read.y.shape[1] == 2
    assert not np.isinf(read.y).any()


TOKENS = [
    "time",
    "flow 1",
    "level",
    ",",
    ";",
    "\n",
    "\r",
    '"',
    "1",
    "0.5",
    "1e308",
    "-2",
    "nan",
    "2024-01-01",
    "T00:00",
]


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(body=st.lists(st.sampled_from(TOKENS), max_size=40).map("".join) | st.text(max_size=60))
def test_any_text_is_measurements_or_a_plain_refusal(tmp_path: Path, body: str) -> None:
    path = tmp_path / "fuzz.csv"
    path.write_bytes(f"time,flow 1,level\n{body}".encode(errors="ignore"))
    try:
        read = read_measurements(path, PLAIN)
    except SecurestateError:
        return
    assert len(read.y) >= 1
    assert read.time is not None
    assert np.all(read.time[1:] > read.time[:-1])


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(content=st.binary(max_size=300), suffix=st.sampled_from([".csv", ".parquet", ".nc", ".tsv"]))
def test_any_bytes_are_measurements_or_a_plain_refusal(tmp_path: Path, content: bytes, suffix: str) -> None:
    path = tmp_path / f"fuzz{suffix}"
    path.write_bytes(content)
    refused(path)


@pytest.fixture(scope="module")
def run() -> Run:
    y = np.array([[1.0, 2.0], [nan, 4.0], [5.0, nan], [nan, nan]])
    return KalmanFilter(PLAIN).run(y)


def stamped(run: Run) -> Run:
    return run.with_time(np.datetime64("2024-01-01", "ns") + np.arange(4) * np.timedelta64(1500, "ms"))


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_written_table_holds_every_number_of_the_run(tmp_path: Path, run: Run, suffix: str) -> None:
    path = tmp_path / f"out{suffix}"
    write_run(stamped(run), path)
    read = pd.read_csv(path) if suffix == ".csv" else pd.read_parquet(path)
    expected = stamped(run).to_pandas().reset_index()
    assert list(read.columns) == list(expected.columns)
    assert {"x.x1", "x_std.x1", "trust.level", "attack.flow 1", "innovation.flow 1", "status"} <= set(
        read.columns
    )
    for name in expected.columns.drop("time"):
        np.testing.assert_array_equal(read[name].astype(float), expected[name].astype(float), err_msg=name)
    np.testing.assert_array_equal(pd.to_datetime(read["time"]).astype("datetime64[ns]"), expected["time"])


def test_written_netcdf_is_the_labelled_run(tmp_path: Path, run: Run) -> None:
    write_run(stamped(run), tmp_path / "out.nc")
    with xr.open_dataset(tmp_path / "out.nc", engine="h5netcdf") as read:
        xr.testing.assert_equal(read.load(), stamped(run).to_xarray())


def test_times_in_a_written_csv_have_as_few_decimals_as_lose_nothing(tmp_path: Path, run: Run) -> None:
    write_run(stamped(run), tmp_path / "out.csv")
    rows = (tmp_path / "out.csv").read_text().splitlines()
    assert rows[2].startswith("2024-01-01T00:00:01.500,")


@pytest.mark.parametrize("name", ["out.txt", "out", "nowhere/out.csv", "folder.csv"])
def test_a_place_that_cannot_be_written_is_refused(tmp_path: Path, run: Run, name: str) -> None:
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(InputError, match="path"):
        write_run(run, tmp_path / name)
    assert [path.name for path in tmp_path.iterdir()] == ["folder.csv"]


@pytest.mark.parametrize("failure", [OSError("disk full"), KeyboardInterrupt(), MemoryError()])
@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".nc"])
def test_a_failed_write_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch, failure: BaseException, suffix: str
) -> None:
    path = tmp_path / f"out{suffix}"
    path.write_text("old")

    def fail(*_: object) -> None:
        raise failure

    monkeypatch.setattr(os, "fsync", fail)  # everything is written by then, nothing is moved yet
    with pytest.raises(InputError if isinstance(failure, OSError) else type(failure)):
        write_run(run, path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_written_file_is_as_readable_as_any_new_file(tmp_path: Path, run: Run) -> None:
    write_run(run, tmp_path / "out.csv")
    (tmp_path / "plain").touch()
    mode = stat.S_IMODE((tmp_path / "out.csv").stat().st_mode)
    assert mode == stat.S_IMODE((tmp_path / "plain").stat().st_mode)


def test_a_link_to_a_file_is_followed(tmp_path: Path, run: Run) -> None:
    (tmp_path / "real.csv").write_text("old")
    (tmp_path / "out.csv").symlink_to(tmp_path / "real.csv")
    write_run(run, tmp_path / "out.csv")
    assert (tmp_path / "out.csv").is_symlink()
    assert (tmp_path / "real.csv").read_text() != "old"

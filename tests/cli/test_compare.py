"""The command that compares: files, what is printed, interruptions, mistakes."""

import os
import signal
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from securestate.simulation import campaign
from securestate.simulation.suite import load_suite
from tests.cli.helpers import Command

SUITE = """
[suite]
name = "Two tanks"
runs = 20
steps = 30
score_from = 10
seed = 3

[[plant]]
name = "tanks"
file = "plant.toml"

[[attack]]
name = "nobody"
kind = "none"

[[attack]]
name = "bias"
kind = "bias"
size = 12.0
on = "flow 2"

[[estimator]]
method = "kalman"

[[estimator]]
name = "sparse 0.9"
method = "sparse"
kalman_probability = 0.9
"""

FILES = {"table.nc", "table.csv", "sensors.csv", "timing.csv", "results.sqlite"}
#: The command, as a process whose every task ends after one group and takes a while.
SLOW = """
import signal, sys, time
signal.signal(signal.SIGINT, signal.default_int_handler)
from securestate.cli import main
from securestate.simulation import _campaign, _store
_campaign.work.__kwdefaults__["budget"] = 0.0
put = _store.FileStore.put
def slow(self, results):
    put(self, results)
    print("kept", flush=True)
    time.sleep(0.05)
_store.FileStore.put = slow
sys.exit(main())
"""


@pytest.fixture
def suite(folder: Path) -> Path:
    path = folder / "suite.toml"
    path.write_text(SUITE, encoding="utf-8")
    return path


def kept(folder: Path) -> dict[str, bytes]:
    """The files whose bytes do not depend on who computed them."""
    return {name: (folder / name).read_bytes() for name in ("table.nc", "table.csv", "sensors.csv")}


def rows(folder: Path) -> list[tuple[object, ...]]:
    """Everything that is kept of a comparison."""
    with closing(sqlite3.connect(folder / "results.sqlite")) as db:
        return db.execute("SELECT * FROM results ORDER BY 1, 2").fetchall()


def test_it_writes_tables_and_prints_the_ranking(suite: Path, command: Command) -> None:
    done = command("compare", "suite.toml", "--out", "results")
    assert (done.code, done.err) == (0, "")
    assert {path.name for path in (suite.parent / "results").iterdir()} == FILES
    lines = done.out.splitlines()
    assert lines[0].startswith("Comparison(2 scenarios × 3 estimators), mean squared error over the oracle's")
    rule = next(i for i, line in enumerate(lines) if line.startswith("──"))
    ranked = [line.split()[0] for line in lines[rule + 1 : rule + 4]]
    assert ranked == ["sparse", "kalman", "oracle"]
    assert [line for line in lines if line.startswith("wrote ")] == [
        f"wrote results/{name}" for name in ("table.nc", "table.csv", "sensors.csv", "timing.csv")
    ]


def test_its_numbers_are_those_of_the_library(suite: Path, command: Command) -> None:
    assert command("compare", "suite.toml", "--out", "results", "--quiet").out == ""
    loaded = load_suite(suite)
    result = campaign(loaded.scenarios, loaded.recipes)
    table = pd.read_csv(suite.parent / "results" / "table.csv")
    np.testing.assert_array_equal(table["mse"], result.to_pandas()["mse"])
    with xr.open_dataset(suite.parent / "results" / "table.nc", engine="h5netcdf") as saved:
        np.testing.assert_array_equal(saved["ratio"].values, result.table["ratio"].values)


def test_the_report_is_one_file_with_the_suites_name(suite: Path, command: Command) -> None:
    done = command("compare", "suite.toml", "--out", "results", "--report", "report.html")
    assert done.code == 0
    assert "wrote report.html" in done.out
    page = (suite.parent / "report.html").read_text(encoding="utf-8")
    assert "Two tanks" in page
    assert "suite.toml" in page


def test_workers_change_nothing_and_a_second_call_computes_nothing(suite: Path, command: Command) -> None:
    for out, workers in (("one", "1"), ("two", "2")):
        assert command("compare", "suite.toml", "--out", out, "--workers", workers, "--quiet").code == 0
    first = kept(suite.parent / "one")
    assert kept(suite.parent / "two") == first
    before = rows(suite.parent / "one")
    assert command("compare", "suite.toml", "--out", "one", "--quiet").code == 0
    assert rows(suite.parent / "one") == before  # times included
    assert kept(suite.parent / "one") == first


def test_runs_on_the_command_line_stand_for_those_of_the_file(suite: Path, command: Command) -> None:
    assert command("compare", "suite.toml", "--out", "few", "--runs", "3", "--quiet").code == 0
    assert set(pd.read_csv(suite.parent / "few" / "table.csv")["runs"]) == {3}


def test_what_cannot_run_is_told_with_its_reason(suite: Path, command: Command) -> None:
    cold = '[[scenario]]\nplant = "tanks"\nattacks = ["bias"]\nprior_variance = 100.0\n'
    suite.write_text(SUITE + cold, encoding="utf-8")
    done = command("compare", "suite.toml", "--out", "results")
    assert done.code == 0
    assert "sparse 0.9 cannot run in 1 scenario: prior.P: expected None" in " ".join(done.out.split())


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGKILL, -signal.SIGKILL)])
def test_a_comparison_stopped_in_the_middle_goes_on_to_the_same_bytes(
    suite: Path, command: Command, number: signal.Signals, code: int
) -> None:
    arguments = ("compare", "suite.toml", "--out", "stopped", "--workers", "1", "--runs", "60")
    running = subprocess.Popen(
        [sys.executable, "-c", SLOW, *arguments],
        cwd=suite.parent,
        env=os.environ | {"NO_COLOR": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        encoding="utf-8",
    )
    assert running.stdout is not None
    for _ in range(3):
        assert running.stdout.readline() == "kept\n"
    running.send_signal(number)
    _, err = running.communicate(timeout=60)
    assert running.returncode == code
    assert "Traceback" not in err
    if number == signal.SIGINT:
        assert "what is done is kept in stopped; the same command goes on from there" in err
    assert {path.name for path in (suite.parent / "stopped").iterdir()} <= {
        "results.sqlite",
        "results.sqlite-journal",
    }
    for out in ("stopped", "whole"):
        assert command("compare", "suite.toml", "--out", out, "--runs", "60", "--quiet").code == 0
    assert kept(suite.parent / "stopped") == kept(suite.parent / "whole")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["suite.toml"], "Missing option '--out'"),
        (["nothing.toml", "--out", "o"], "nothing.toml: suite: expected a readable TOML file"),
        (["suite.toml", "--out", "o", "--runs", "0"], "runs: expected a whole number >= 1"),
        (["suite.toml", "--out", "o", "--workers", "0"], "workers: expected a whole number >= 1"),
        (["suite.toml", "--out", "o", "--report", "r.pdf"], "--report: expected a file name ending in .html"),
        (["suite.toml", "--out", "o", "--report", "no/r.html"], "--report"),
        (["suite.toml", "--out", "plant.toml"], "plant.toml"),
    ],
)
def test_a_mistake_ends_with_2_and_its_name(
    suite: Path, command: Command, arguments: list[str], message: str
) -> None:
    before = {path.name for path in suite.parent.iterdir()}
    done = command("compare", *arguments)
    assert done.code == 2
    assert done.err.startswith("error: ")
    assert message in done.err
    assert not {path.name for path in suite.parent.iterdir()} - before - {"o"}


def test_a_folder_that_something_else_is_in_is_left_as_it_is(suite: Path, command: Command) -> None:
    out = suite.parent / "o"
    out.mkdir()
    (out / "results.sqlite").write_text("my own notes")
    done = command("compare", "suite.toml", "--out", "o")
    assert done.code == 2
    assert "results.sqlite" in done.err
    assert (out / "results.sqlite").read_text() == "my own notes"

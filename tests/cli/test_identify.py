"""The command that learns a plant from history."""

import io
import re
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

import securestate as ss
from securestate.cli import console
from tests.cli.helpers import Command, history

SAMPLES = 400


@pytest.fixture
def tank(folder: Path) -> Path:
    """The folder with history.csv, other.csv, and faulty.csv, in which one meter lies."""
    history(SAMPLES).to_csv(folder / "history.csv", index=False)
    history(300, seed=2).to_csv(folder / "other.csv", index=False)
    faulty = history(300, seed=2)
    faulty["left"] = 3 * faulty["left"]
    faulty.to_csv(folder / "faulty.csv", index=False)
    return folder


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def rows(out: str, *names: str) -> list[list[str]]:
    cells = [re.split(r"\s{2,}", line.strip()) for line in out.splitlines()]
    return [row for row in cells if row[0] in names]


def learned(*paths: str, held_out: str | None = None, **options: object) -> ss.Identified:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ss.SecurestateWarning)
        other = None if held_out is None else ss.read_history(held_out)
        return ss.identify(ss.read_history(list(paths)), held_out=other, **options)  # type: ignore[arg-type]


def test_it_writes_the_plant_and_says_what_it_is_worth_and_what_is_next(tank: Path, command: Command) -> None:
    done = command("identify", "history.csv", "-o", "tank.toml")
    found = learned("history.csv")
    assert (done.code, done.err) == (0, "")
    assert ss.Plant.load("tank.toml") == found.plant
    said = [found.headline, "History: 400 samples in 1 segment, one every 60 s.", *found.verdict.sentences()]
    assert done.out.startswith("\n".join(said) + "\n\n")
    evidence = found.verdict.sensors
    table = rows(done.out, "left", "middle", "right")
    assert [row[:2] for row in table] == [["left", "yes"], ["middle", "yes"], ["right", "yes"]]
    assert [row[2] for row in table] == [f"{100 * sensor.explained:.1f} %" for sensor in evidence]
    assert [row[4] for row in table] == [f"{sensor.variance:.2f}" for sensor in evidence]
    assert done.out.endswith(
        "\nwrote tank.toml\nNext:\n  securestate analyse tank.toml --tolerance 1e-3\n"
        "  securestate estimate --plant tank.toml --data NEW.csv --report report.html\n"
    )


def test_the_next_commands_can_be_typed_as_they_are_shown(tank: Path, command: Command) -> None:
    command("identify", "history.csv", "--order", "1", "-o", "tank.toml")
    assert command("analyse", "tank.toml", "--tolerance", "1e-3").code == 0
    estimate = command("estimate", "--plant", "tank.toml", "--data", "faulty.csv", "--report", "report.html")
    assert estimate.code == 3
    assert "1 of 3 sensors lies: left." in estimate.out
    quoted = command("identify", "history.csv", "--order", "1", "-o", "my tank.toml").out
    assert "securestate analyse 'my tank.toml' --tolerance 1e-3" in quoted


def test_decimal_commas_give_the_same_plant(tank: Path, command: Command) -> None:
    history(SAMPLES).to_csv(tank / "comma.csv", index=False, sep=";", decimal=",")
    assert command("identify", "comma.csv", "--order", "1", "-o", "comma.toml", "--quiet").code == 0
    assert ss.Plant.load("comma.toml") == learned("history.csv", order=1).plant


def test_several_files_gaps_and_runs_make_segments(tank: Path, command: Command) -> None:
    frame = history(150).drop(index=[20, *range(50, 90)])
    frame["run"] = np.where(frame["time"] < 60 * 120, "a", "b")
    frame.to_csv(tank / "gaps.csv", index=False)
    history(150, seed=2).to_csv(tank / "short.csv", index=False)
    done = command(
        "identify", "gaps.csv", "short.csv", "--segment-column", "run", "--order", "1", "-o", "tank.toml"
    )
    assert (done.code, done.err) == (0, "")
    assert "History: 260 samples in 4 segments, one every 60 s, 0.4 % of the readings missing." in done.out


def test_inputs_channels_and_columns_to_ignore_are_lists_of_names(tank: Path, command: Command) -> None:
    rng = np.random.default_rng(5)
    frame = history(SAMPLES)
    frame["valve, main"], frame["pump"], frame["note"] = (
        rng.normal(size=SAMPLES),
        rng.normal(size=SAMPLES),
        "ok",
    )
    frame.to_csv(tank / "driven.csv", index=False)
    options = ("--inputs", '"valve, main", pump', "--order", "1", "--name", "big tank", "--dt", "60")
    done = command(
        "identify", "driven.csv", *options, "--ignore", "note", "--ignore", "middle", "-o", "1.toml"
    )
    plant = ss.Plant.load("1.toml")
    assert (plant.name, plant.dt, plant.n) == ("big tank", 60.0, 1)
    assert (plant.input_names, plant.channel_names) == (("valve, main", "pump"), ("left", "right"))
    assert done.out.startswith("big tank of 1 state learned from 400 samples of 2 channels and 2 inputs.")
    command("identify", "driven.csv", *options, "--channels", "left,right", "-o", "2.toml", "--quiet")
    assert ss.Plant.load("2.toml") == plant


@pytest.mark.filterwarnings("default")
def test_feedthrough_is_asked_for_and_warned_of(tank: Path, command: Command) -> None:
    rng = np.random.default_rng(6)
    frame = pd.DataFrame({"a": rng.normal(size=SAMPLES), "b": rng.normal(size=SAMPLES)})
    frame["controller"] = frame["a"] + 0.1 * rng.normal(size=SAMPLES)
    frame.to_csv(tank / "loop.csv", index=False)
    options = ("loop.csv", "--inputs", "controller", "--order", "1", "-o", "loop.toml")
    assert "vouch for" not in command("identify", *options).out
    done = command("identify", *options, "--feedthrough")
    assert done.err == ""
    assert done.out.count("Only inputs of the same sample vouch for a (") == 1


def test_another_record_decides_the_verdict(tank: Path, command: Command) -> None:
    done = command("identify", "history.csv", "--held-out", "other.csv", "--order", "1", "-o", "tank.toml")
    found = learned("history.csv", held_out="other.csv", order=1)
    assert done.code == 0
    assert str(found.verdict) in done.out
    assert ss.Plant.load("tank.toml") == found.plant


def test_an_inadequate_model_is_written_and_ends_with_4(tank: Path, command: Command) -> None:
    options = ("--order", "1", "--held-out", "faulty.csv", "-o", "tank.toml")
    done = command("identify", "history.csv", *options)
    assert done.code == 4
    assert done.err == "tank.toml is written, but its model is inadequate: judge no sensor by it\n"
    assert "The model is inadequate" in done.out
    assert "wrote tank.toml" in done.out
    assert "Next:" not in done.out
    assert ss.Plant.load("tank.toml").n == 1
    assert command("identify", "history.csv", *options, "--quiet") == (4, "", done.err)


def test_what_was_done_to_the_data_is_said_once(tank: Path, command: Command) -> None:
    frame = history(SAMPLES)
    frame["stuck"] = 7.0
    frame.to_csv(tank / "stuck.csv", index=False)
    done = command("identify", "stuck.csv", "--order", "1", "-o", "tank.toml")
    assert (done.code, done.err) == (0, "")
    assert done.out.count("stuck never changes in the history and is left out.") == 1


@pytest.mark.filterwarnings("default")
def test_quiet_prints_nothing_but_warnings(tank: Path, command: Command) -> None:
    frame = history(SAMPLES)
    frame.to_csv(tank / "fine.csv", index=False)
    frame["stuck"] = 7.0
    frame.to_csv(tank / "stuck.csv", index=False)
    assert command("identify", "fine.csv", "--order", "1", "-o", "tank.toml", "--quiet") == (0, "", "")
    done = command("identify", "stuck.csv", "--order", "1", "-o", "tank.toml", "--quiet")
    said = "warning: stuck never changes in the history and is left out.\n"
    assert done == (0, "", said)


def test_the_report_is_one_file_with_the_names_of_the_history(tank: Path, command: Command) -> None:
    before = {path.name for path in tank.iterdir()}
    options = ("--order", "1", "-o", "tank.toml", "--report", "report.html")
    done = command("identify", "history.csv", "other.csv", *options)
    assert "\nwrote tank.toml\nwrote report.html\nNext:" in done.out
    assert {path.name for path in tank.iterdir()} - before == {"tank.toml", "report.html"}
    html = (tank / "report.html").read_text(encoding="utf-8")
    assert "<dd>history.csv, other.csv</dd>" in html
    assert "</html>" in html


def test_a_place_that_cannot_be_written_leaves_nothing_behind(
    tank: Path, command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tank / "tank.toml").write_text("old")
    before = files(tank)

    def fail(*_: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr("os.replace", fail)
    done = command("identify", "history.csv", "--order", "1", "-o", "tank.toml")
    assert (done.code, done.out) == (2, "")
    assert "disk full" in done.err
    assert files(tank) == before


def test_ctrl_c_ends_with_130_and_leaves_no_file(
    tank: Path, command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    before, seen = files(tank), []

    @contextmanager
    def stopped(*, quiet: bool) -> Iterator[Callable[[str, int, int], None]]:
        def show(stage: str, _: int, total: int) -> None:
            seen.append(stage)
            if total > 1:
                raise KeyboardInterrupt

        assert not quiet
        yield show

    monkeypatch.setattr(console, "stages", stopped)
    done = command("identify", "history.csv", "-o", "tank.toml", "--report", "report.html")
    assert (done.code, done.out) == (130, "")
    assert done.err == "error: interrupted; no file was changed by halves\n"
    assert seen[0] == "looking at the past"
    assert seen[-1] == "fitting"
    assert files(tank) == before


def test_a_terminal_shows_every_stage_and_how_far_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = io.StringIO()
    terminal = Console(file=screen, force_terminal=True, width=60)
    monkeypatch.setattr(console, "Console", lambda **_: terminal)
    with console.stages(quiet=False) as show:
        for step in (("order 3", 0, 1), ("fitting", 1, 155), ("fitting", 40, 155), ("judging", 0, 1)):
            show(*step)
            time.sleep(0.25)  # it is drawn ten times a second
    shown = re.sub(r"\x1b\[[\d;?]*[a-zA-Z]", "", screen.getvalue())
    assert re.search(r"order 3 .*fitting .* 40/155.*judging", shown, re.DOTALL)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["history.csv"], "Missing option '--out'"),
        (["-o", "tank.toml"], "Missing argument"),
        (["nothing.csv", "-o", "tank.toml"], "nothing.csv: expected a readable file"),
        (["history.csv", "-o", "tank.json"], "--out: expected a file name ending in .toml"),
        (["history.csv", "-o", "no/tank.toml"], "--out: expected a file in a folder that exists"),
        (
            ["history.csv", "-o", "tank.toml", "--report", "r.pdf"],
            "--report: expected a file name ending in .html",
        ),
        (
            ["history.csv", "-o", "tank.toml", "--report", "no/r.html"],
            "--report: expected a file in a folder",
        ),
        (["history.csv", "-o", "tank.toml", "--order", "0"], "'0' is neither a whole number >= 1 nor auto"),
        (
            ["history.csv", "-o", "tank.toml", "--order", "two"],
            "'two' is neither a whole number >= 1 nor auto",
        ),
        (["history.csv", "-o", "tank.toml", "--inputs", "lefts"], "(perhaps 'left' for 'lefts')"),
        (["history.csv", "-o", "tank.toml", "--inputs", "left,"], "--inputs: a name is empty"),
        (["history.csv", "-o", "tank.toml", "--ignore", '"left'], "--ignore: unexpected end of data"),
        (["history.csv", "-o", "tank.toml", "--dt", "50"], "column 'time': expected the first time"),
        (["history.csv", "-o", "tank.toml", "--feedthrough"], "feedthrough: expected inputs, or False"),
        (["history.csv", "-o", "tank.toml", "--held-out", "honest.csv"], "honest.csv: expected a column for"),
        (["short.csv", "-o", "tank.toml"], "expected at least 50 samples"),
    ],
)
def test_a_mistake_ends_with_2_and_its_name(
    tank: Path, command: Command, arguments: list[str], message: str
) -> None:
    history(10).to_csv(tank / "short.csv", index=False)
    before = files(tank)
    done = command("identify", *arguments)
    assert (done.code, done.out) == (2, "")
    assert done.err.startswith("error: ")
    assert message in done.err
    assert files(tank) == before


def test_help_tells_what_4_means_here(command: Command) -> None:
    out = " ".join(command("identify", "--help").out.split())
    assert "4 the model is inadequate" in out
    assert "securestate identify january.csv february.csv" in out

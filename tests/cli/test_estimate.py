"""`securestate estimate`: its files, its table, its exit codes, and that it leaves nothing half-done."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import securestate as ss
from securestate.cli import job, methods
from securestate.estimators import DEFAULT, METHODS
from securestate.measurements import read_measurements
from tests.cli.helpers import PLANT, Command

HONEST = ("estimate", "--plant", "plant.toml", "--data", "honest.csv")
LYING = ("estimate", "--plant", "plant.toml", "--data", "lying.csv")


def files(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_a_lying_sensor_is_named_first_with_what_it_adds_and_the_exit_code_is_3(command: Command) -> None:
    end = command(*LYING)
    assert (end.code, end.err) == (3, "")
    rows = end.out.splitlines()
    first = rows[next(i for i, row in enumerate(rows) if "───" in row or "---" in row) + 1]
    assert first.startswith("flow 2")
    assert "LIES" in first
    assert 0.6 < float(first.split("LIES")[1].split("%")[0]) / 100 < 0.7
    assert "m³/h" in first
    assert abs(float(first.split("+")[1].split()[0]) - 8) < 0.5
    assert sum("LIES" in row for row in rows) == 1
    assert "1 of 4 sensors lies: flow 2." in end.out


def test_honest_sensors_end_with_0(command: Command) -> None:
    end = command(*HONEST)
    assert (end.code, end.err) == (0, "")
    assert "LIES" not in end.out
    assert "Fast path" in command(*HONEST, "--method", "sparse").out


def test_the_table_says_whom_no_other_sensor_can_vouch_for(command: Command, folder: Path) -> None:
    nobody_for(("flow 1", "flow 2", "level"), folder)
    rows = command(*LYING, "--method", "sparse").out.splitlines()
    cells = [row.split("  ")[0] for row in rows]
    assert rows[cells.index("flow 1")].split()[2:5] == ["cannot", "be", "checked"]
    assert "LIES" in rows[cells.index("flow 2 (cannot be checked)")]
    assert "cannot be checked" not in rows[cells.index("flow 3")]
    assert "cannot be checked" not in rows[cells.index("level (protected)")]
    end = rows.index("2 of 4 sensors cannot be checked: no other sensor vouches for them.")
    assert rows[end - 1] == "" and rows[end + 1].startswith("Steps: ")
    assert "cannot be checked" not in command(*HONEST, "--quiet").out


def nobody_for(names: tuple[str, ...], folder: Path) -> None:
    """Mark sensors of the plant in the folder."""
    sensors = [s.replaced(verifiable=s.name not in names) for s in PLANT.sensors]
    ss.Plant(PLANT.A, PLANT.Q, sensors, dt=PLANT.dt, name=PLANT.name).save(folder / "plant.toml")


def test_a_window_tells_who_was_heard_without_a_check(command: Command, folder: Path) -> None:
    nobody_for(("flow 1",), folder)
    out = " ".join(command(*HONEST, "--prior", "window").out.split())
    assert "believed: flow 2, flow 3 and level; heard without a check: flow 1." in out


def test_a_finding_is_told_since_when_how_much_and_how_surely(command: Command, folder: Path) -> None:
    frame = pd.read_csv(folder / "lying.csv")
    frame.loc[250:, "flow 2"] -= 8
    frame.loc[50:120, "flow 3"] -= 5
    frame.loc[150:154, frame.columns[1:]] = np.nan
    frame.to_csv(folder / "lying.csv", index=False)
    out = " ".join(command(*LYING, "--method", "gate", "--false-alarm-rate", "0.001").out.split())
    assert "2 of 4 sensors lie: flow 2 and flow 3." in out
    assert "flow 2 lied from 50.0 s to 124.5 s (samples 100 to 249): about +8.0" in out
    assert "suspected in 145 of 145 samples, 0.14 by chance, mean trust 0.0" in out
    assert "m³/h, constant; suspected" in out
    assert "flow 3 lied from 25.0 s to 60.0 s (samples 50 to 120): about -" in out
    assert "NO_MEASUREMENT in 5 samples, from 75.0 s to 77.0 s (samples 150 to 154): nothing arrived" in out


def test_findings_are_written_for_programs(command: Command, folder: Path) -> None:
    end = command(*LYING, "--findings", "liars.json", "--quiet")
    assert (end.code, end.out) == (3, "")
    found = json.loads((folder / "liars.json").read_text())
    assert (found["liars"], found["source"], found["samples"]) == (["flow 2"], "lying.csv", 300)
    (one,) = (finding for finding in found["findings"] if finding["verdict"] == "lies")
    assert (one["sensor"], one["since"], one["ongoing"]) == ("flow 2", {"sample": 100, "time": 50.0}, True)
    assert one["injections"][0]["last"] == pytest.approx(8, abs=0.5)
    assert (one["injections"][0]["unit"], one["injections"][0]["kind"]) == ("m³/h", "constant")


def test_auto_is_the_default_and_takes_the_settings_of_what_it_stands_for(
    command: Command, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert command(*LYING).out == command(*LYING, "--method", DEFAULT).out
    monkeypatch.setattr(methods, "DEFAULT", "gate")
    chosen = command(*LYING, "--false-alarm-rate", "0.02").out
    assert chosen == command(*LYING, "--method", "gate", "--false-alarm-rate", "0.02").out
    refused = command(*LYING, "--gamma", "1")
    assert (
        refused.err
        == "error: --gamma: expected --method sparse, received --method auto, which stands for gate\n"
    )


def test_auto_never_takes_another_method_in_silence_but_names_those_that_fit(
    command: Command, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    R = np.diag([0.1, 0.1, 0.1, 0.2, 0.2])
    R[0, 1] = R[1, 0] = 0.05
    sensors = [ss.Sensor(s.name, C=s.C) for s in PLANT.sensors]
    ss.Plant(PLANT.A, PLANT.Q, sensors, R=R, dt=PLANT.dt).save(folder / "plant.toml")
    monkeypatch.setattr(methods, "DEFAULT", "innovation-mixture")
    end = command(*LYING, "--out", "states.csv")
    assert (end.code, end.out) == (4, "")
    assert end.err.startswith(
        "error: --method auto stands for innovation-mixture, which cannot be used here: "
    )
    assert "or use --method" in end.err and "--method kalman (trusts every sensor)" in end.err
    assert not (folder / "states.csv").exists()


def test_exit_zero_is_for_scripts_that_do_not_care(command: Command) -> None:
    assert command(*LYING, "--exit-zero").code == 0


def test_the_kalman_filter_trusts_a_liar_and_says_so(command: Command) -> None:
    end = command(*LYING, "--method", "kalman")
    assert end.code == 0
    assert "trusts every sensor" in end.out


@pytest.mark.parametrize(
    "method",
    [
        ("gate",),
        ("chi-square", "--scope", "central", "--on-alarm", "drop-worst"),
        ("adaptive-joint", "--window", "10", "--gate", "16"),
    ],
)
def test_a_detector_names_the_liar(command: Command, method: tuple[str, ...]) -> None:
    end = command(*LYING, "--method", *method, "--false-alarm-rate", "0.001")
    assert (end.code, end.err) == (3, "")
    assert "1 of 4 sensors lies: flow 2." in end.out


def test_help_offers_every_registered_method(command: Command) -> None:
    end = command("estimate", "--help")
    assert all(name in end.out for name in ("auto", *METHODS))
    assert f"auto stands for {DEFAULT}" in " ".join(end.out.replace("│", " ").split())


def test_files_and_report_are_written_and_named_at_the_end(command: Command, folder: Path) -> None:
    end = command(*LYING, "--out", "states.parquet", "--report", "report.html")
    assert end.out.splitlines()[-2:] == ["wrote states.parquet", "wrote report.html"]
    assert "flow 2" in (folder / "report.html").read_text()
    table = pd.read_parquet(folder / "states.parquet")
    assert len(table) == 300
    assert table["suspected.flow 2"].iloc[110:].mean() > 0.9
    assert files(folder) == {"plant.toml", "honest.csv", "lying.csv", "states.parquet", "report.html"}


def test_blocks_say_exactly_what_one_run_says(
    command: Command, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(job, "BLOCK", 77)
    command(*LYING, "--method", "sparse", "--out", "states.nc", "--covariance")
    data = read_measurements(folder / "lying.csv", PLANT)
    expected = ss.SparseFusion(PLANT).run(data.y).with_time(data.time).to_xarray()
    with xr.open_dataset(folder / "states.nc", engine="h5netcdf") as written:
        xr.testing.assert_equal(written.load(), expected)


def test_settings_reach_the_estimator(command: Command, folder: Path) -> None:
    options = ("--method", "sparse", "--kalman-probability", "0.5", "--no-refit")
    command(*HONEST, *options, "--out", "states.parquet")
    data = read_measurements(folder / "honest.csv", PLANT)
    expected = ss.SparseFusion(PLANT, kalman_probability=0.5, refit=False).run(data.y)
    table = pd.read_parquet(folder / "states.parquet")
    np.testing.assert_array_equal(table[["x.x1", "x.x2"]], expected.x)
    assert expected.diagnostics["fast_path"].mean() < 0.7


def test_a_mixture_takes_its_settings_from_the_command_line(command: Command, folder: Path) -> None:
    options = ("--epsilon", "none", "--init", "median", "--mean", "precision", "--cap", "40", "--start", "5")
    end = command(*HONEST, "--method", "mixture", *options, "--feedback", "--out", "states.parquet")
    assert end.code in (0, 3)
    data = read_measurements(folder / "honest.csv", PLANT)
    settings = {"init": "median", "mean": "precision", "cap": 40, "start": 5, "feedback": True}
    expected = ss.MixtureFusion(PLANT, epsilon=None, **settings).run(data.y)  # type: ignore[arg-type]
    table = pd.read_parquet(folder / "states.parquet")
    np.testing.assert_array_equal(table[["x.x1", "x.x2"]], expected.x)
    assert (
        "epsilon: expected a number in [0, 1], or None"
        in command(*HONEST, "--method", "mixture", "--epsilon", "half").err
    )


def test_quiet_prints_nothing_but_does_everything(command: Command, folder: Path) -> None:
    end = command(*LYING, "--quiet", "--out", "states.csv")
    assert end == (3, "", "")
    assert len(pd.read_csv(folder / "states.csv")) == 300


def test_what_was_done_to_the_data_is_said(command: Command, folder: Path) -> None:
    frame = pd.read_csv(folder / "honest.csv").drop(index=[5, 6]).drop(columns="flow 3").assign(note="x")
    frame.to_csv(folder / "honest.csv", index=False)
    assert command(*HONEST).code == 2
    end = command(*HONEST, "--allow-missing", "--report", "report.html")
    sentences = (
        "2 samples inserted where the file has none; all channels missing there.",
        "No column for flow 3: missing throughout.",
        "1 column not used: note.",
    )
    for sentence in sentences:
        assert sentence in end.out
        assert sentence in (folder / "report.html").read_text()


def test_rows_without_time_are_taken_as_consecutive_samples_and_that_is_said(
    command: Command, folder: Path
) -> None:
    pd.read_csv(folder / "honest.csv").drop(columns="time").to_csv(folder / "honest.csv", index=False)
    assert "consecutive samples" in command(*HONEST).out


def test_another_time_column_can_be_named(command: Command, folder: Path) -> None:
    pd.read_csv(folder / "honest.csv").rename(columns={"time": "stamp"}).to_csv(
        folder / "honest.csv", index=False
    )
    assert "1 column not used: stamp." in command(*HONEST).out
    assert "not used" not in command(*HONEST, "--time-column", "stamp").out


def test_inputs_are_held_over_a_gap_only_if_asked_for_and_that_is_said(
    command: Command, folder: Path
) -> None:
    sensors = [ss.Sensor(name, C=[1], R=0.1) for name in ("flow 1", "flow 2", "flow 3")]
    ss.Plant([[0.9]], [[0.1]], sensors, B=[[1]], input_names=["valve"], dt=0.5).save(folder / "plant.toml")
    frame = pd.read_csv(folder / "honest.csv").assign(valve=1.0)
    frame["flow 1"] = frame["flow 2"]
    frame.drop(index=[7]).to_csv(folder / "honest.csv", index=False)
    refusal = command(*HONEST)
    assert (refusal.code, "hold_inputs" in refusal.err) == (2, True)
    end = command(*HONEST, "--hold-inputs", "--exit-zero")
    assert end.code == 0
    assert "1 sample with inputs held at their last known value." in end.out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--method", "sparse", "--gamma", "1", "--kalman-probability", "0.9"), "gamma"),
        (("--method", "sparse", "--kalman-probability", "2"), "kalman_probability"),
        (("--method", "kalman", "--gamma", "1"), "--gamma: expected --method sparse"),
        (
            ("--method", "sparse", "--false-alarm-rate", "0.1"),
            "--false-alarm-rate: expected --method secure, adaptive-joint, joint, protected, gate,",
        ),
        (("--method", "gate", "--window", "5"), "--window: expected --method adaptive-joint or joint"),
        (("--method", "adaptive-joint", "--gate", "0"), "gate: expected a number > 0"),
        (("--method", "gate", "--scope", "central"), "--scope: expected --method chi-square"),
        (("--method", "gate", "--false-alarm-rate", "1"), "false_alarm_rate"),
        (("--method", "chi-square", "--on-alarm", "predict"), "on_alarm"),
        (("--method", "magic"), "--method"),
        (("--gamma", "much"), "--gamma"),
        (("--nonsense",), "--nonsense"),
        (("--out", "states.xlsx"), "--out: expected a file name ending in"),
        (("--out", "nowhere/states.csv"), "--out: expected a file in a folder that exists"),
        (("--report", "nowhere/report.html"), "--report: expected a file in a folder that exists"),
        (("--report", "report.pdf"), "--report: expected a file name ending in .html"),
        (("--findings", "liars.csv"), "--findings: expected a file name ending in .json"),
        (("--findings", "nowhere/liars.json"), "--findings: expected a file in a folder that exists"),
        (("--covariance", "--out", "states.csv"), "--covariance"),
        (("--out", "honest.csv"), "--out: expected another file than --data"),
        (("--time-column", "tme"), "time"),
    ],
)
def test_bad_usage_is_one_line_on_stderr_and_2(
    command: Command, folder: Path, arguments: tuple[str, ...], words: str
) -> None:
    before = files(folder)
    end = command(*HONEST, *arguments)
    assert (end.code, end.out) == (2, "")
    assert end.err.startswith("error: ")
    assert words in end.err
    assert len(end.err.splitlines()) == 1
    assert files(folder) == before


def test_outputs_are_checked_before_anything_is_read(command: Command) -> None:
    end = command("estimate", "--plant", "none.toml", "--data", "none.csv", "--out", "states.xlsx")
    assert "--out" in end.err


@pytest.mark.parametrize("missing", ["--plant", "--data"])
def test_a_missing_file_is_named(command: Command, missing: str) -> None:
    arguments = list(HONEST)
    arguments[arguments.index(missing) + 1] = "none.toml" if missing == "--plant" else "none.csv"
    end = command(*arguments)
    assert (end.code, end.out) == (2, "")
    assert "none." in end.err


@pytest.mark.parametrize("damage", ["text", "inf", "time"])
def test_bad_data_keep_the_old_output(command: Command, folder: Path, damage: str) -> None:
    frame = pd.read_csv(folder / "lying.csv").astype(object)
    cell = {"text": (290, "flow 1", "abc"), "inf": (290, "flow 1", "inf"), "time": (290, "time", 0)}[damage]
    frame.loc[cell[0], cell[1]] = cell[2]
    frame.to_csv(folder / "lying.csv", index=False)
    (folder / "states.csv").write_text("old")
    end = command(*LYING, "--out", "states.csv")
    assert end.code == 2
    assert f"lying.csv, line 292, column '{cell[1]}'" in end.err
    assert (folder / "states.csv").read_text() == "old"


def test_a_plant_that_the_method_cannot_handle_ends_with_4_and_advice(command: Command, folder: Path) -> None:
    sensors = [ss.Sensor("flow 1", C=[0, 1], R=1)]
    blind = ss.Plant(A=[[1.1, 0], [0, 0.5]], Q=np.eye(2), sensors=sensors, dt=0.5)
    blind.save(folder / "plant.toml")
    for method in METHODS:
        end = command(*HONEST, "--method", method, "--out", "states.csv")
        assert (end.code, end.out) == (4, "")
        assert end.err.startswith("error: ")
        assert "advice: " in end.err
        assert not (folder / "states.csv").exists()


def test_a_bug_ends_with_1_and_asks_for_a_report(command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise RuntimeError("boom")

    monkeypatch.setattr(job, "summarise", broken)
    end = command(*HONEST)
    assert end.code == 1
    assert "boom" in end.err
    assert "bug of securestate" in end.err


def test_an_interrupt_while_writing_ends_with_130_and_keeps_the_old_file(
    command: Command, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    before = files(folder) | {"states.csv"}
    (folder / "states.csv").write_text("old")
    monkeypatch.setattr("os.fsync", interrupted)
    end = command(*HONEST, "--out", "states.csv")
    assert (end.code, end.out) == (130, "")
    assert (folder / "states.csv").read_text() == "old"
    assert files(folder) == before


def test_names_with_markup_and_other_alphabets_are_shown_as_they_are(command: Command, folder: Path) -> None:
    sensors = [ss.Sensor(name, C=[[1.0]], R=1.0) for name in ("[red]Füllstand[/red]", "流量", ":warning:")]
    ss.Plant(A=[[0.9]], Q=[[1.0]], sensors=sensors).save(folder / "plant.toml")
    (folder / "honest.csv").write_text("[red]Füllstand[/red],流量,:warning:\n1,2,3\n")
    end = command(*HONEST)
    assert end.code == 0
    for sensor in sensors:
        assert sensor.name in end.out


def test_a_sample_time_that_does_not_fit_the_file_is_pointed_at(command: Command, folder: Path) -> None:
    frame = pd.read_csv(folder / "honest.csv").iloc[::10]
    frame.to_csv(folder / "sparse.csv", index=False)
    end = command("estimate", "--plant", "plant.toml", "--data", "sparse.csv", "--method", "kalman")
    assert "Most samples are inserted: the plant asks for one every 0.5 s; check dt." in " ".join(
        end.out.split()
    )


def test_the_bias_monitor_is_calibrated_on_clean_files_and_others_refuse_them(command: Command) -> None:
    calibrated = command(*LYING, "--method", "bias-monitor", "--calibrate-on", "honest.csv")
    assert (calibrated.code, calibrated.err) == (3, "")
    assert "1 of 4 sensors lies: flow 2." in calibrated.out
    missing = command(*LYING, "--method", "bias-monitor", "--calibrate-on", "nowhere.csv")
    assert missing.code == 2 and "nowhere.csv" in missing.err
    foreign = command(*LYING, "--calibrate-on", "honest.csv")
    assert foreign.code == 2
    assert "--calibrate-on: expected --method bias-monitor, received --method auto, which" in foreign.err

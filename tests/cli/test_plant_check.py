"""`securestate plant check`: what it says of a plant, and its exit codes."""

from pathlib import Path

import numpy as np
import pytest

import securestate as ss
from securestate.estimators import AUTO, DEFAULT, METHODS
from tests.cli.helpers import Command


def test_a_good_plant_is_described_and_ends_with_0(command: Command) -> None:
    end = command("plant", "check", "plant.toml")
    assert (end.code, end.err) == (0, "")
    assert "two tanks: 2 states, 4 sensors, 5 channels, 0 inputs, one sample every 0.5 s" in end.out
    assert "2 stable, 0 marginal, 0 unstable; largest |eigenvalue| 0.95" in end.out
    assert "Detectable: yes." in end.out
    for name in METHODS:
        assert f"Method {name}{f' ({AUTO})' if name == DEFAULT else ''}: can be used." in end.out


def test_noise_is_shown_in_the_unit_of_the_files(command: Command) -> None:
    rows = command("plant", "check", "plant.toml").out.splitlines()
    flow = next(row for row in rows if row.startswith("flow 1"))
    assert f"{2 * np.sqrt(0.1):.4g}" in flow
    assert "m³/h" in flow


def test_who_is_not_verifiable_is_shown_if_there_is_any(command: Command, folder: Path) -> None:
    assert "verifiable" not in command("plant", "check", "plant.toml").out
    sensors = [ss.Sensor("a", C=[1], R=1), ss.Sensor("b", C=[1], R=1, verifiable=False)]
    ss.Plant([[0.5]], [[1]], sensors).save(folder / "plant.toml")
    rows = command("plant", "check", "plant.toml").out.splitlines()
    where = next(row for row in rows if row.startswith("sensor")).index("verifiable")
    said = {row.split()[0]: row[where:].split()[0] for row in rows if row.startswith(("a ", "b "))}
    assert said == {"a": "yes", "b": "no"}


def test_an_unseen_unstable_mode_is_named_and_no_estimator_means_4(command: Command, folder: Path) -> None:
    sensors = [ss.Sensor("gauge", C=[0, 1], R=1)]
    plant = ss.Plant([[1.1, 0], [0, 0.5]], np.eye(2), sensors, state_names=["mass", "heat"])
    plant.save(folder / "plant.toml")
    end = command("plant", "check", "plant.toml")
    assert end.code == 4
    assert "1 stable, 0 marginal, 1 unstable" in end.out
    assert "Detectable: no, no sensor sees mode 1.1 (mass)." in end.out
    assert end.out.count("cannot be used: ") == len(METHODS)


def test_the_modes_that_a_sensor_alone_does_not_see_are_named(command: Command, folder: Path) -> None:
    sensors = [ss.Sensor("a", C=[1, 0], R=1), ss.Sensor("b", C=[0, 1], R=1)]
    ss.Plant([[1, 0], [0, 1.2]], np.eye(2), sensors).save(folder / "plant.toml")
    rows = command("plant", "check", "plant.toml").out.splitlines()
    assert next(row for row in rows if row.startswith("a ")).rstrip().endswith("mode 1.2 (x2)")
    assert next(row for row in rows if row.startswith("b ")).rstrip().endswith("mode 1 (x1)")


def test_a_plant_that_varies_in_time_needs_a_prior_and_so_python(command: Command, folder: Path) -> None:
    A = np.stack([np.eye(1), 0.5 * np.eye(1)])
    ss.Plant(A, [[1]], [ss.Sensor("a", C=[1], R=1)]).save(folder / "plant.toml")
    end = command("plant", "check", "plant.toml")
    assert end.code == 4
    assert "varies in time over 2 samples" in end.out
    assert "Method kalman: cannot be used" in end.out
    assert "with a prior" in end.out
    assert "Method sparse: cannot be used" in end.out


@pytest.mark.parametrize("content", ["", "nonsense", "[plant]\nA = [[1]]\n", "\x00\x01"])
def test_an_invalid_file_ends_with_2_and_one_line(command: Command, folder: Path, content: str) -> None:
    (folder / "plant.toml").write_text(content)
    end = command("plant", "check", "plant.toml")
    assert (end.code, end.out) == (2, "")
    assert end.err.startswith("error: ")
    assert len(end.err.splitlines()) == 1

"""The power grids as plants, against flows that are computed branch by branch."""

import csv
import math
import sys
from collections.abc import Callable
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from numpy.typing import NDArray

from securestate import Plant

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
FOLDER = EXAMPLES / "power-grids"
SIZES = {"case14": (13, 57, 3), "case39": (38, 140, 9), "case118": (117, 519, 29), "case300": (299, 1197, 75)}

#: All sensors that see the angle of the last bus on a branch, and that branch from the other bus to the last.
FOUR = {
    "case14": ([13, 33, 46, 47], 7, 8),
    "case39": ([19, 65, 101, 123], 10, 32),
    "case118": ([182, 368, 439, 487], 68, 116),
    "case300": ([393, 804, 824, 1070], 3, 7003),
}


def script(name: str) -> ModuleType:
    spec = spec_from_file_location(f"power_grids_{name}", FOLDER / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module", params=SIZES)
def case(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def plant(case: str) -> Plant:
    made: Plant = script("grids").dc_grid(case)
    return made


def readings(case: str, wave: Callable[[float], float]) -> Callable[[dict[int, float]], list[float]]:
    """What flows and injections are at given angles, if `wave` turns an angle's difference into power."""
    with (FOLDER / f"{case}.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    ends = [(int(row["from"]), int(row["to"])) for row in rows]
    strength = [1 / (float(row["x"]) * (float(row["tap"]) or 1.0)) for row in rows]

    def at(angles: dict[int, float]) -> list[float]:
        flows = [s * wave(angles[i] - angles[j]) for (i, j), s in zip(ends, strength, strict=True)]
        leaving = dict.fromkeys(sorted(angles), 0.0)
        for (start, end), flow in zip(ends, flows, strict=True):
            leaving[start] += flow
            leaving[end] -= flow
        return [*flows, *(-flow for flow in flows), *leaving.values()]

    return at


def test_counts_are_those_of_the_case(case: str, plant: Plant) -> None:
    n, m, angles = SIZES[case]
    assert (plant.n, plant.m, plant.n_sensors, plant.n_inputs, plant.dt) == (n, m, m, 0, 1.0)
    kinds = [name.split()[0] for name in plant.sensor_names]
    flows = m - (n + 1) - angles
    assert kinds == ["flow"] * flows + ["injection"] * (n + 1) + ["angle"] * angles
    assert [plant.units[0], plant.units[-1]] == ["p.u.", "rad"]


def test_every_name_is_used_once(plant: Plant) -> None:
    assert len(set(plant.sensor_names)) == plant.m
    assert len(set(plant.state_names)) == plant.n


def seen(C: NDArray[np.float64]) -> int:
    """How many directions of the state the rows of C see."""
    power = np.linalg.eigvalsh(C.T @ C)
    return int(np.sum(power > 1e-12 * power[-1]))


def test_every_sensor_sees_something_and_together_they_see_all(plant: Plant) -> None:
    assert np.abs(plant.C).max(axis=1).min() > 0.1
    assert seen(plant.C) == plant.n


def test_without_the_four_sensors_of_a_bus_on_one_branch_its_angle_is_unseen(case: str, plant: Plant) -> None:
    four, near, last = FOUR[case]
    around = {f"flow {near}-{last}", f"flow {last}-{near}", f"injection {near}", f"injection {last}"}
    assert {plant.sensor_names[i] for i in four} == around
    assert np.flatnonzero(plant.C[:, plant.state_names.index(f"angle of bus {last}")]).tolist() == four
    assert seen(np.delete(plant.C, four, axis=0)) == plant.n - 1


def test_a_rows_numbers_are_the_slopes_of_the_power_flow(case: str, plant: Plant) -> None:
    read, step = readings(case, math.sin), 1e-5
    buses = [int(name.removeprefix("injection ")) for name in plant.sensor_names if name.startswith("inj")]
    states = [int(name.removeprefix("angle of bus ")) for name in plant.state_names]
    flat = dict.fromkeys(buses, 0.0)
    slopes: list[NDArray[np.float64]] = []
    for bus in states:
        up, down = read(flat | {bus: step}), read(flat | {bus: -step})
        slopes.append((np.array(up) - np.array(down)) / (2 * step))
    np.testing.assert_allclose(plant.C[: len(slopes[0])], np.transpose(slopes), rtol=1e-8, atol=1e-8)


def test_an_angle_sensor_reads_the_angle_of_its_bus(plant: Plant) -> None:
    angles = {name: row for name, row in zip(plant.sensor_names, plant.C, strict=True) if "angle" in name}
    for name, row in angles.items():
        expected = [float(state == name.replace("angle", "angle of bus")) for state in plant.state_names]
        assert row.tolist() == expected


def test_the_14_bus_grid_sees_what_the_example_of_that_grid_sees() -> None:
    plant, known = script("grids").dc_grid("case14"), np.load(EXAMPLES / "ieee14" / "dc_case14.npz")
    assert plant.sensor_names == Plant.load(EXAMPLES / "ieee14" / "plant.toml").sensor_names
    for letter in "ACR":
        np.testing.assert_allclose(getattr(plant, letter), known[letter], rtol=1e-13)


def test_a_grid_needs_no_pypower(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pypower", None)
    assert script("grids").dc_grid("case39").n == 38


def test_an_unknown_case_is_refused_with_the_known_ones() -> None:
    with pytest.raises(
        ValueError, match=r"expected one of case14, case39, case118, case300, received 'case9'"
    ):
        script("grids").dc_grid("case9")


def test_making_the_files_again_without_pypower_says_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pypower", None)
    with pytest.raises(SystemExit, match=r"PYPOWER is needed to make case14\.csv again \(pip install"):
        script("prepare").load("case14")


def test_a_file_has_the_branches_in_service_and_numbers_as_they_are(tmp_path: Path) -> None:
    table = np.zeros((3, 13))
    table[:, [0, 1, 3, 8, 10]] = [[4, 7, 0.20912, 0.978, 1], [4, 9, 0.1, 0.9, 0], [7, 8, -0.3, 0, 1]]
    script("prepare").write(tmp_path / "case.csv", script("prepare").branches(table))
    written = (tmp_path / "case.csv").read_text(encoding="utf-8")
    assert written == "from,to,x,tap\n4,7,0.20912,0.978\n7,8,-0.3,0.0\n"

"""Plant files: the tables of a TOML file, and the arrays of an NPZ file beside it, in and out.

The format is documented in `securestate.plant`. A file that cannot be used gives a PlantError that names the
file and the key. A file is written whole or not at all.
"""

import difflib
import os
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from securestate import _checks as check
from securestate import _plant_build as build
from securestate._sensor import Sensor
from securestate.errors import PlantError

PLANT_KEYS = ("name", "dt", "arrays", "state_names", "A", "B", "Q", "R", "D")
SENSOR_KEYS = ("name", "C", "R", "D", "protected", "verifiable", "channels", "offset", "scale", "unit")
INPUT_KEYS = ("name", "offset", "scale")
STATE_KEYS = ("name",)
TABLES = ("plant", "state", "input", "sensor")
MATRICES = ("A", "B", "C", "Q", "R", "D", "offset", "scale")

Table = dict[str, Any]


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Put the file's name in front of the argument of every PlantError raised inside."""
    try:
        yield
    except PlantError as error:
        raise PlantError(f"{path}: {error.argument}", error.expected, error.received) from None


def plant_path(path: object) -> Path:
    """Return the path of a plant file, which ends in .toml."""
    if not isinstance(path, str | os.PathLike) or isinstance(os.fspath(path), bytes):
        raise PlantError("path", "the path of a .toml file", check.describe(path))
    target = Path(path)
    if target.suffix != ".toml":
        raise PlantError("path", "a file name ending in .toml", repr(str(path)))
    return target


def plant_arguments(path: Path) -> Table:
    """Read a plant file and return the arguments of `Plant`."""
    document = _tables(path)
    plant = document["plant"]
    arrays = _arrays(path, plant.pop("arrays", None))
    plant = _with_arrays("[plant]", plant, arrays)
    sensors = [_with_arrays(_at("sensor", i), table, arrays) for i, table in enumerate(document["sensor"])]
    return {
        **plant,
        **_state_names(plant, document["state"]),
        **_inputs(document["input"]),
        "Q": _process_noise(plant),
        "sensors": [_sensor(i, table) for i, table in enumerate(sensors)],
    }


def _tables(path: Path) -> dict[str, Any]:
    """Return the file's tables, every key of them known."""
    content = _parsed(path)
    _refuse_unknown("", content, TABLES)
    plant = content.get("plant")
    if not isinstance(plant, dict):
        raise PlantError("[plant]", "a table", "none" if plant is None else check.describe(plant))
    _refuse_unknown("[plant]", plant, PLANT_KEYS)
    _require("[plant]", plant, ("A", "Q"))
    tables: dict[str, Any] = {"plant": dict(plant)}
    tables["state"] = _rows("state", content, STATE_KEYS, ("name",))
    tables["input"] = _rows("input", content, INPUT_KEYS, ("name",))
    tables["sensor"] = _rows("sensor", content, SENSOR_KEYS, ("name", "C"))
    return tables


def _parsed(path: Path) -> Table:
    try:
        if not path.is_file():
            raise PlantError("plant file", "a file", "nothing there" if not path.exists() else "not a file")
        return tomllib.loads(path.read_bytes().decode("utf-8-sig"))
    except (OSError, UnicodeDecodeError) as error:
        raise PlantError("plant file", "readable text in UTF-8", str(error)) from None
    except RecursionError:
        raise PlantError("plant file", "valid TOML", "brackets nested too deeply") from None
    except PlantError:
        raise
    except ValueError as error:
        raise PlantError("plant file", "valid TOML", str(error)) from None


def _rows(kind: str, content: Table, keys: tuple[str, ...], required: tuple[str, ...]) -> list[Table]:
    rows = content.get(kind, [])
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise PlantError(f"[[{kind}]]", f"tables written as [[{kind}]]", check.describe(rows))
    for i, row in enumerate(rows):
        _refuse_unknown(_at(kind, i), row, keys)
        _require(_at(kind, i), row, required)
    return rows


def _at(kind: str, index: int) -> str:
    return f"[[{kind}]] number {index + 1}"


def _refuse_unknown(where: str, table: Mapping[str, object], known: tuple[str, ...]) -> None:
    for key in table:
        if key not in known:
            expected = f"a key among {', '.join(known)}"
            raise PlantError(f"{where} {key}".strip(), expected, _unknown(key, known))


def _unknown(key: str, known: Iterable[str]) -> str:
    """Say that a key is unknown, and which known one comes nearest."""
    folded = {candidate.casefold(): candidate for candidate in known}
    close = difflib.get_close_matches(key.casefold(), folded, n=1)
    return f"unknown {key!r}" + (f" (did you mean {folded[close[0]]!r}?)" if close else "")


def _require(where: str, table: Table, required: tuple[str, ...]) -> None:
    for key in required:
        if key not in table:
            raise PlantError(f"{where} {key}", "a value", "none")


def _arrays(path: Path, name: object) -> dict[str, check.Array]:
    """Read the NPZ file beside the plant file; no array in it may hold Python objects."""
    if name is None:
        return {}
    if not isinstance(name, str) or not name or Path(name).name != name or "\0" in name:
        raise PlantError("[plant] arrays", "the name of an .npz file beside it", check.describe(name))
    beside = path.parent / name
    if not beside.is_file():
        raise PlantError("[plant] arrays", f"a file {beside}", "nothing there")
    try:
        with np.load(BytesIO(beside.read_bytes()), allow_pickle=False) as stored:
            return {key: stored[key] for key in stored.files}
    except Exception as error:  # a damaged archive fails in zipfile, zlib or numpy, each in its own way
        raise PlantError("[plant] arrays", f"an NPZ file of plain arrays in {beside}", str(error)) from None


def _with_arrays(where: str, table: Table, arrays: dict[str, check.Array]) -> Table:
    """Replace every matrix that is given by name."""
    named = {key: value for key, value in table.items() if key in MATRICES and isinstance(value, str)}
    for key, value in named.items():
        if value not in arrays:
            known = "numbers, or the name of an array in the file that `arrays` names"
            raise PlantError(f"{where} {key}", known, _unknown(value, arrays))
    return table | {key: arrays[value] for key, value in named.items()}


def _sensor(index: int, table: Table) -> Sensor:
    check.label(f"{_at('sensor', index)} name", table["name"], PlantError)
    return Sensor(**table)


def _state_names(plant: Table, states: list[Table]) -> Table:
    if not states:
        return {}
    if "state_names" in plant:
        raise PlantError("[plant] state_names", "state_names or [[state]]", "both")
    return {"state_names": [state["name"] for state in states]}


def _inputs(inputs: list[Table]) -> Table:
    if not inputs:
        return {}
    return {
        "input_names": [table["name"] for table in inputs],
        "input_offset": [_number(i, table, "offset", 0.0) for i, table in enumerate(inputs)],
        "input_scale": [_number(i, table, "scale", 1.0) for i, table in enumerate(inputs)],
    }


def _number(index: int, table: Table, key: str, default: float) -> float:
    value = table.get(key, default)
    return float(check.shaped(f"{_at('input', index)} {key}", value, (), ", one number", PlantError))


def _process_noise(plant: Table) -> check.Array:
    """Return Q as a matrix; a file may give one variance or a diagonal."""
    numbers = check.real_array("Q", plant["Q"], PlantError)
    n = build.dynamics(plant["A"]).shape[-1]
    return np.diag(np.broadcast_to(numbers, (n,))) if numbers.shape in ((), (n,)) else numbers

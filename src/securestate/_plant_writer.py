"""Write a plant as TOML that people can read, large matrices in an NPZ file beside it."""

import json
import zipfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from securestate._checks import Array
from securestate._files import whole_file
from securestate.errors import PlantError

if TYPE_CHECKING:
    from securestate.plant import Plant

INLINE_EACH = 400  # numbers in one matrix that is still written in the TOML file
INLINE_ALL = 4000  # numbers in all matrices together
INLINE_ALWAYS = 16  # numbers in a matrix that is never worth an array of its own

Table = dict[str, Any]


def write_plant(plant: "Plant", path: Path) -> None:
    """Write the files of a plant, each whole or not at all, the arrays first.

    Raises:
        PlantError: the files cannot be written; nothing is left behind.
    """
    tables = [("[plant]", "", _plant_table(plant))]
    tables += [("[[input]]", "", _input_table(plant, i)) for i in range(plant.n_inputs)]
    tables += [("[[sensor]]", f"sensor{i + 1}.", _sensor_table(plant, i)) for i in range(plant.n_sensors)]
    arrays = _moved_to_arrays(tables)
    beside = path.with_suffix(".npz")
    if arrays:
        tables[0][2]["arrays"] = beside.name
    text = "\n".join(_table_text(header, table) for header, _, table in tables)
    contents: dict[Path, Callable[[IO[bytes]], object]] = {}
    if arrays:
        contents[beside] = lambda stream: _write_arrays(stream, arrays)
    contents[path] = lambda stream: stream.write(text.encode())
    _write_whole(contents)


def _plant_table(plant: "Plant") -> Table:
    table: Table = {"name": plant.name} if plant.name else {}
    table |= {"dt": plant.dt, "state_names": list(plant.state_names), "A": plant.A, "Q": _compact(plant.Q)}
    if plant.n_inputs:
        table["B"] = plant.B
    if not _noise_is_per_sensor(plant):
        table["R"] = plant.R
    return table


def _input_table(plant: "Plant", i: int) -> Table:
    offset, scale = plant.input_offset[i], plant.input_scale[i]
    return {"name": plant.input_names[i], "offset": float(offset), "scale": float(scale)}


def _sensor_table(plant: "Plant", i: int) -> Table:
    sensor, rows = plant.sensors[i], plant.channels_of(i)
    table: Table = {"name": sensor.name}
    if sensor.channels != (sensor.name,):
        table["channels"] = list(sensor.channels)
    table["C"] = _rows(sensor.C)
    if _noise_is_per_sensor(plant):
        table["R"] = _compact(plant.R[rows, rows])
    if np.any(plant.D[rows]):
        table["D"] = _rows(plant.D[rows])
    if sensor.protected:
        table["protected"] = True
    if not sensor.verifiable:
        table["verifiable"] = False
    if any(sensor.unit):
        table["unit"] = sensor.unit[0] if len(set(sensor.unit)) == 1 else list(sensor.unit)
    if np.any(sensor.offset):
        table["offset"] = _alike(sensor.offset)
    if np.any(sensor.scale != 1):
        table["scale"] = _alike(sensor.scale)
    return table


def _noise_is_per_sensor(plant: "Plant") -> bool:
    same = plant.channel_sensor[:, None] == plant.channel_sensor
    return not np.any(plant.R[~same])


def _compact(matrix: Array) -> Array:
    """Return a covariance as one variance, or as variances, if that says all."""
    diagonal = np.diag(matrix)
    if not np.array_equal(matrix, np.diag(diagonal)):
        return matrix
    return diagonal[0] if len(diagonal) == 1 else diagonal


def _rows(matrix: Array) -> Array:
    return matrix[0] if matrix.ndim == 2 and len(matrix) == 1 else matrix


def _alike(numbers: Array) -> Array:
    return numbers[0] if np.all(numbers == numbers[0]) else numbers


def _moved_to_arrays(tables: list[tuple[str, str, Table]]) -> dict[str, Array]:
    """Replace matrices by names if some are too large to read, and return them by name."""
    found = [
        (table, key, prefix + key, value)
        for _, prefix, table in tables
        for key, value in table.items()
        if isinstance(value, np.ndarray)
    ]
    sizes = [value.size for *_, value in found]
    if max(sizes, default=0) <= INLINE_EACH and sum(sizes) <= INLINE_ALL:
        return {}
    moved: dict[str, Array] = {}
    for table, key, name, value in found:
        if value.size > INLINE_ALWAYS:
            table[key], moved[name] = name, value
    return moved


def _write_arrays(stream: IO[bytes], arrays: dict[str, Array]) -> None:
    """Write an NPZ archive: one .npy member per array."""
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.ascontiguousarray(array), allow_pickle=False)


def _table_text(header: str, table: Table) -> str:
    return "\n".join([header, *(f"{key} = {_text(value)}" for key, value in table.items())]) + "\n"


def _text(value: object) -> str:
    """Write a value as TOML; a float keeps every bit."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, float):
        return repr(float(value))
    if isinstance(value, np.ndarray):
        return _array_text(value, "")
    assert isinstance(value, list)
    return "[" + ", ".join(map(_text, value)) + "]"


def _array_text(array: Array, indent: str) -> str:
    if array.ndim <= 1:
        return str(array.tolist())
    inner = indent + "  "
    rows = "".join(f"{inner}{_array_text(row, inner)},\n" for row in array)
    return f"[\n{rows}{indent}]"


def _write_whole(contents: dict[Path, Callable[[IO[bytes]], object]]) -> None:
    """Write all files beside their places, then move them there one after the other."""
    for path in contents:
        if path.is_dir():
            raise PlantError(str(path), "the name of a file", "a folder")
    with ExitStack() as moves:  # undone in reverse: the last file is begun first and moved last
        parts = {path: moves.enter_context(_plant_file(path)) for path in reversed(contents)}
        for path, write in contents.items():
            with _named(path), parts[path].open("wb") as stream:
                write(stream)


@contextmanager
def _plant_file(path: Path) -> Iterator[Path]:
    with _named(path), whole_file(path) as part:
        yield part


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Say of which file it was that it cannot be written."""
    try:
        yield
    except PlantError:
        raise
    except (OSError, ValueError) as error:
        raise PlantError(str(path), "a place that can be written", str(error)) from None

"""NetCDF as columns along time: one variable per channel, or one table with named columns."""

from collections import Counter
from io import BytesIO
from typing import Any

import h5py
import xarray as xr
from numpy.typing import NDArray

CLASSIC = b"CDF"  # how a file of NetCDF 3 begins


def columns_of(data: bytes) -> dict[str, NDArray[Any]]:
    """Return every series along the time dimension by name; times are datetime64 or as they are stored.

    A variable (time,) is a column. A variable (time, label) whose second dimension is labelled with text is
    one column per label, called as the label, or "variable.label" where two such variables share labels.

    Raises:
        ValueError: no dimension along which the file's variables run.
    """
    if not data.startswith(CLASSIC):
        _refuse_damage(data)
    engine: Any = "scipy" if data.startswith(CLASSIC) else "h5netcdf"
    with xr.open_dataset(BytesIO(data), engine=engine, decode_timedelta=False) as file:
        dataset = file.load()
    rows = _row_dimension(dataset)
    columns = {
        str(name): values.to_numpy() for name, values in dataset.variables.items() if values.dims == (rows,)
    }
    tables = _tables(dataset, rows)
    shared = Counter(label for labels, _ in tables.values() for label in labels)
    for variable, (labels, values) in tables.items():
        for label, column in zip(labels, values.T, strict=True):
            plain = shared[label] == 1 and label not in columns
            columns[label if plain else f"{variable}.{label}"] = column
    return columns


def _refuse_damage(data: bytes) -> None:
    """Raise where the engine, which touches the same things, would also print a traceback."""
    with h5py.File(BytesIO(data), "r") as file:
        file.attrs.get("_nc3_strict")


def _row_dimension(dataset: xr.Dataset) -> str:
    """Return the dimension called time, or that of a variable called time, or the most frequent one."""
    named = [str(dim) for dim in dataset.dims if str(dim).lower() == "time"]
    named += [
        str(v.dims[0]) for name, v in dataset.variables.items() if str(name).lower() == "time" and v.ndim == 1
    ]
    used = Counter(str(dim) for values in dataset.variables.values() for dim in values.dims)
    if not used:
        raise ValueError("no variable has a dimension")
    return named[0] if named else used.most_common(1)[0][0]


def _tables(dataset: xr.Dataset, rows: str) -> dict[str, tuple[list[str], NDArray[Any]]]:
    found = {}
    for name, values in dataset.data_vars.items():
        others = [dim for dim in values.dims if dim != rows]
        if values.ndim == 2 and len(others) == 1 and others[0] in dataset.coords:
            labels = dataset.coords[others[0]].to_numpy()
            if labels.dtype.kind in "UOT" and all(isinstance(label, str) for label in labels):
                found[str(name)] = ([str(label) for label in labels], values.transpose(rows, ...).to_numpy())
    return found

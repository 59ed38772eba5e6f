"""Make history.csv, data.csv, tags.csv and plant.toml from the files they come from.

    python prepare.py FOLDER

FOLDER holds `d00.dat` and `d00_te.dat` (500 and 960 samples of normal operation, 52 variables) of the
Tennessee Eastman data of the University of Illinois, and `clean_segments.npz` (ten arrays, 160 samples of
normal operation each, from other runs of the same simulation). Numbers are taken over exactly: the text of
every number in the CSV files reads back as the same double.

plant.toml is no part of the tour: the arena needs a plant that does not change when `identify` does. It comes
from `identified_model.npz`, which lies beside this script.
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from securestate import Plant, Sensor

HERE = Path(__file__).resolve().parent
SAMPLE_TIME = 180.0  # seconds
CONTINUOUS = 22  # the first 22 variables are the continuous measurements

#: What XMEAS 1 to 22 measure, and in which unit.
MEASURED = (
    ("A feed", "kscmh"),
    ("D feed", "kg/h"),
    ("E feed", "kg/h"),
    ("A and C feed", "kscmh"),
    ("recycle flow", "kscmh"),
    ("reactor feed", "kscmh"),
    ("reactor pressure", "kPa gauge"),
    ("reactor level", "%"),
    ("reactor temperature", "°C"),
    ("purge rate", "kscmh"),
    ("separator temperature", "°C"),
    ("separator level", "%"),
    ("separator pressure", "kPa gauge"),
    ("separator underflow", "m³/h"),
    ("stripper level", "%"),
    ("stripper pressure", "kPa gauge"),
    ("stripper underflow", "m³/h"),
    ("stripper temperature", "°C"),
    ("stripper steam flow", "kg/h"),
    ("compressor work", "kW"),
    ("reactor coolant outlet", "°C"),
    ("separator coolant outlet", "°C"),
)


def plant() -> Plant:
    """Name the identified model's sensors; its operating point keeps files in engineering units."""
    model = np.load(HERE / "identified_model.npz")
    sensors = [
        Sensor(
            f"{channel} {what}",
            channels=[str(channel)],
            C=model["C"][i],
            R=model["R"][i, i],
            unit=unit,
            offset=model["y_offset"][i],
            scale=model["y_scale"][i],
        )
        for i, (channel, (what, unit)) in enumerate(zip(model["names"], MEASURED, strict=True))
    ]
    return Plant(model["A"], model["Q"], sensors, dt=SAMPLE_TIME, name="Tennessee Eastman process")


def record(samples: NDArray[np.float64]) -> pd.DataFrame:
    """Return the continuous measurements with their time in seconds."""
    table = pd.DataFrame(samples[:, :CONTINUOUS], columns=[f"XMEAS {i + 1}" for i in range(CONTINUOUS)])
    table.insert(0, "time", np.arange(len(table)) * int(SAMPLE_TIME))
    return table


def history(segments: dict[str, NDArray[np.float64]]) -> pd.DataFrame:
    """Put the separate runs below each other; the column `run` tells them apart."""
    tables = [record(samples).assign(run=name) for name, samples in segments.items()]
    joined = pd.concat(tables, ignore_index=True)
    return joined[["run", *tables[0].columns.drop("run")]]


def tags() -> pd.DataFrame:
    """Return what every channel is called and in which unit it is."""
    rows = [(f"XMEAS {i + 1}", f"XMEAS {i + 1} {what}", unit) for i, (what, unit) in enumerate(MEASURED)]
    return pd.DataFrame(rows, columns=["channel", "sensor", "unit"])


def main() -> None:
    """Write the four files beside this script."""
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    originals = Path(sys.argv[1])
    plant().save(HERE / "plant.toml")
    record(np.loadtxt(originals / "d00_te.dat")).to_csv(HERE / "data.csv", index=False)
    segments = {"d00": np.loadtxt(originals / "d00.dat").T} | dict(np.load(originals / "clean_segments.npz"))
    history(segments).to_csv(HERE / "history.csv", index=False)
    tags().to_csv(HERE / "tags.csv", index=False)


if __name__ == "__main__":
    main()

"""The main job on a power grid: one of 57 sensors lies; estimate, name it, write a report.

    python run.py [--out FOLDER]

FOLDER (default: out, beside this script) receives the simulated record (clean.csv, attacked.csv, truth.csv),
estimates.parquet and report.html.
"""

import argparse
from pathlib import Path

import numpy as np
import pandas as pd
import simulate
from numpy.typing import NDArray

from securestate import KalmanFilter, Plant
from securestate.cli import execute
from securestate.cli.exits import Exit
from securestate.measurements import read_measurements

HERE = Path(__file__).resolve().parent
PLANT = HERE / "plant.toml"

Array = NDArray[np.float64]


def main() -> int:
    """Do the job; return 0, or the command line's exit code if it failed."""
    out = _folder()
    attacked = simulate.main(out)
    estimates, report = out / "estimates.parquet", out / "report.html"
    command = ["estimate", "--plant", PLANT, "--data", attacked]
    code = execute([str(word) for word in [*command, "--out", estimates, "--report", report]])
    if code not in (Exit.CLEAN, Exit.SUSPECTED):
        return code
    print()
    compare(out, pd.read_parquet(estimates))
    print(f"\nReport: {report}")
    return 0


def _folder() -> Path:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, default=HERE / "out", help="folder for the results")
    folder: Path = parser.parse_args().out
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def compare(out: Path, secure: pd.DataFrame) -> None:
    """Say what was done, what was found, and how far each method is from the true flow and angles."""
    plant = Plant.load(PLANT)
    truth = np.deg2rad(pd.read_csv(out / "truth.csv").to_numpy())
    ways = {
        "Kalman filter": kalman(plant, out / "attacked.csv"),
        "SecureFilter": secure[[f"x.{name}" for name in plant.state_names]].to_numpy(),
        "Kalman filter without the lie": kalman(plant, out / "clean.csv"),
    }
    print(f"{simulate.LIAR}: falsified by {simulate.SIZE:+g} MW from second {simulate.START} on.")
    print(f"  {found(secure)}")
    i = plant.channel_names.index(simulate.LIAR)
    print("RMS errors of the estimates while it lies:")
    for name, x in ways.items():
        error = (x - truth)[simulate.START :]
        flow, angles = rms(error @ plant.C[i]) * plant.scale[i], np.rad2deg(rms(error))
        print(f"  {name + ':':<31}flow 4-5 {flow:.2f} MW, all angles {angles:.4f}°")


def kalman(plant: Plant, record: Path) -> Array:
    """Return the Kalman filter's states for a record, (T, n)."""
    data = read_measurements(record, plant)
    return KalmanFilter(plant).run(data.y, data.u).x


def rms(error: Array) -> float:
    """Root mean square of all numbers."""
    return float(np.sqrt(np.mean(error**2)))


def found(estimates: pd.DataFrame) -> str:
    """Say when the meter was suspected and what it is estimated to add."""
    seconds = estimates["time"].to_numpy()
    suspected = estimates[f"suspected.{simulate.LIAR}"].to_numpy(dtype=bool)
    if not suspected.any():
        return "Never suspected."
    share = suspected[seconds >= simulate.START].mean()
    injected = estimates[f"attack.{simulate.LIAR}"][suspected].median()
    return (
        f"Suspected from {seconds[suspected][0] - simulate.START:.0f} s after its first lie on, "
        f"{share:.0%} of the time since then; estimated injection {injected:+.3g} MW."
    )


if __name__ == "__main__":
    raise SystemExit(main())

"""The main job on a chemical plant: falsify two of 22 sensors, estimate, name the liars, write a report.

    python run.py [--out FOLDER]

FOLDER (default: out, beside this script) receives attacked.csv, estimates.parquet and report.html.
"""

import argparse
from pathlib import Path

import falsify
import numpy as np
import pandas as pd
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
    attacked = falsify.main(out / "attacked.csv")
    estimates, report = out / "estimates.parquet", out / "report.html"
    command = ["estimate", "--plant", PLANT, "--data", attacked, "--method", "sparse"]
    code = execute([str(word) for word in [*command, "--out", estimates, "--report", report]])
    if code not in (Exit.CLEAN, Exit.SUSPECTED):
        return code
    print()
    compare(attacked, pd.read_parquet(estimates))
    print(f"\nReport: {report}")
    return 0


def _folder() -> Path:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, default=HERE / "out", help="folder for the results")
    folder: Path = parser.parse_args().out
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def compare(attacked: Path, secure: pd.DataFrame) -> None:
    """Say what was done, what was found, and how far each method is from the estimate on the clean record."""
    plant = Plant.load(PLANT)
    kalman = KalmanFilter(plant)
    clean = shown(plant, kalman.run(read_measurements(HERE / "data.csv", plant).y).x)
    fooled = shown(plant, kalman.run(read_measurements(attacked, plant).y).x)
    fused = shown(plant, secure[[f"x.{name}" for name in plant.state_names]].to_numpy())
    print(
        "What was done, and what was found ('off' is the RMS distance from the estimate on the clean record):"
    )
    for lie in falsify.LIES:
        i = plant.channel_names.index(lie.channel)
        lying, unit = lie.added(times(secure)) != 0, plant.units[i]
        by_kalman, by_fusion = (rms((estimate - clean)[lying, i]) for estimate in (fooled, fused))
        print(f"  {plant.sensor_names[i]}: {told(lie, unit)}")
        print(f"    {found(lie, plant, i, secure)}")
        print(
            f"    Its value is off by {by_kalman:.2g} {unit} (Kalman filter), {by_fusion:.2g} (SparseFusion)."
        )
    worst = [np.max(rms((estimate - clean) / plant.scale)) for estimate in (fooled, fused)]
    print(
        f"  All 22 values: the worst is off by {worst[0]:.2g} (Kalman filter), {worst[1]:.2g} (SparseFusion) "
        "standard deviations\n    of its normal variation."
    )


def shown(plant: Plant, x: Array) -> Array:
    """Return what the sensors would show without noise if x were true, (T, m), engineering units."""
    return plant.denormalise(x @ plant.C.T)


def rms(difference: Array) -> Array:
    """Root mean square over time."""
    return np.asarray(np.sqrt(np.mean(difference**2, axis=0)))


def times(estimates: pd.DataFrame) -> Array:
    """Seconds since the start, (T,)."""
    return estimates["time"].to_numpy(dtype=np.float64)


def told(lie: falsify.Lie, unit: str) -> str:
    """Say what was added."""
    how = f"growing within {lie.ramp:g} h from {lie.start:g} h on" if lie.ramp else f"from {lie.start:g} h on"
    return f"falsified by {lie.size:+g} {unit}, {how}."


def found(lie: falsify.Lie, plant: Plant, i: int, estimates: pd.DataFrame) -> str:
    """Say when the sensor was suspected and what it is estimated to add once the lie has its full size."""
    hours = times(estimates) / 3600
    suspected = estimates[f"suspected.{plant.sensor_names[i]}"].to_numpy(dtype=bool)
    full = suspected & (hours >= lie.start + lie.ramp)
    if not suspected.any():
        return "Never suspected."
    minutes = 60 * (hours[suspected][0] - lie.start)
    share = suspected[hours >= lie.start].mean()
    injected = estimates[f"attack.{lie.channel}"][full].median()
    return (
        f"Suspected from {minutes:.0f} min after the first lie on, {share:.0%} of the time since then; "
        f"estimated injection {injected:+.3g} {plant.units[i]}."
    )


if __name__ == "__main__":
    raise SystemExit(main())

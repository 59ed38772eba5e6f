"""The main job on a chemical plant: learn it from history, ask what it survives, find two lying sensors.

    python run.py [--out FOLDER]

FOLDER (default: out, beside this script) receives plant.toml, attacked.csv, estimates.parquet, and a report
of
each stage: identification.html, resilience.html and report.html.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import falsify
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from securestate import KalmanFilter, Plant, SparseFusion, analyse
from securestate.cli import execute
from securestate.cli.exits import Exit
from securestate.measurements import read_measurements
from securestate.reporting import write_resilience

HERE = Path(__file__).resolve().parent
NAME = "Tennessee Eastman process"
TOLERANCE = 1e-3  # of a model that was learned

Array = NDArray[np.float64]


def main() -> int:
    """Do the job; return 0, or the command line's exit code if it failed."""
    out = _folder()
    plant = out / "plant.toml"
    print("1. Learn the plant from history in which nobody lied\n", flush=True)
    history = [HERE / "history.csv", "--segment-column", "run", "--tags", HERE / "tags.csv"]
    learn = ["identify", *history, "--name", NAME, "--out", plant, "--report", out / "identification.html"]
    code = _command(learn)
    if code != Exit.CLEAN:
        return code
    print("\n2. How many liars does it survive\n", flush=True)
    found = analyse(Plant.load(plant), tol=TOLERANCE)
    print(str(found).split("\n\n")[0])
    print(f"wrote {write_resilience(found, out / 'resilience.html', source=plant.name)}")
    print("\n3. Two sensors lie: name them, and estimate without them\n", flush=True)
    attacked, estimates = falsify.main(out / "attacked.csv"), out / "estimates.parquet"
    order = ["estimate", "--plant", plant, "--data", attacked, "--out", estimates]
    code = _command([*order, "--report", out / "report.html"])
    if code not in (Exit.CLEAN, Exit.SUSPECTED):
        return code
    print()
    compare(Plant.load(plant), attacked, pd.read_parquet(estimates))
    pages = [out / f"{page}.html" for page in ("identification", "resilience", "report")]
    print("\nReports:", *pages, sep="\n  ")
    return 0


def _command(words: Sequence[object]) -> Exit:
    """Run `securestate` as a user would."""
    return execute([str(word) for word in words])


def _folder() -> Path:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, default=HERE / "out", help="folder for the results")
    folder: Path = parser.parse_args().out
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def compare(plant: Plant, attacked: Path, secure: pd.DataFrame) -> None:
    """Say what was done, what was found, and how far each method is from the estimate on the clean record."""
    kalman = KalmanFilter(plant)
    clean = shown(plant, kalman.run(read_measurements(HERE / "data.csv", plant).y).x)
    falsified = read_measurements(attacked, plant).y
    ways = {
        "Kalman filter": shown(plant, kalman.run(falsified).x),
        "SecureFilter": shown(plant, secure[[f"x.{name}" for name in plant.state_names]].to_numpy()),
        "SparseFusion": shown(plant, SparseFusion(plant).run(falsified).x),
    }
    print(
        "What was done, and what was found ('off' is the RMS distance from the estimate on the clean record):"
    )
    for lie in falsify.LIES:
        i = plant.channel_names.index(lie.channel)
        lying, unit = lie.added(times(secure)) != 0, plant.units[i]
        off = {name: rms((estimate - clean)[lying, i]) for name, estimate in ways.items()}
        print(f"  {plant.sensor_names[i]}: {told(lie, unit)}")
        print(f"    {found(lie, plant, i, secure)}")
        print(f"    Its value is off by {listed(off)}, in {unit}.")
    worst = {name: np.max(rms((estimate - clean) / plant.scale)) for name, estimate in ways.items()}
    print(f"  The worst of all 22 values is off by {listed(worst)}, in its normal variation.")


def listed(numbers: dict[str, Any]) -> str:
    """Return numbers in two digits, each with its name."""
    return ", ".join(f"{number:.2g} ({name})" for name, number in numbers.items())


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

"""Make plant.toml from dc_case14.npz, the DC model of the IEEE 14-bus grid. Run it without arguments.

The model is in per unit of 100 MVA and radians; the plant's files are in MW and degrees. Offsets are the
operating point (angles theta0, injections u0), so that the state, deviations from it, starts near zero.
Sensors are named by what a row of C measures; numbers are taken over exactly.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from securestate import Plant, Sensor

HERE = Path(__file__).resolve().parent
BASE = 100.0  # MW per unit
DEGREES = 180 / np.pi  # per radian
SLACK = 1  # the bus whose angle is zero; the model has no column for it

Array = NDArray[np.float64]


def seen_by(kind: str, row: Array) -> str:
    """Name a sensor by its row of C: a flow from its bus to the other, an injection or an angle of a bus.

    A flow meter or an injection meter stands at the bus with the positive coefficient; if there is none, at
    the slack bus, which has no column.
    """
    buses = np.flatnonzero(row) + 2
    at = int(row.argmax()) + 2 if row.max() > 0 else SLACK
    if not kind.startswith("flow"):
        return f"{'angle' if kind == 'pmu_angle' else 'injection'} {at}"
    other = next((int(bus) for bus in buses if bus != at), SLACK)
    return f"flow {at}-{other}"


def plant() -> Plant:
    """Name the model's sensors and inputs and give them engineering units."""
    model = np.load(HERE / "dc_case14.npz")
    kinds = [str(model["kind_names"][kind]) for kind in model["kind"]]
    sensors = []
    for i, kind in enumerate(kinds):
        unit, scale = ("°", DEGREES) if kind == "pmu_angle" else ("MW", BASE)
        row = model["C"][i]
        offset = scale * float(row @ model["theta0"])
        sensors.append(
            Sensor(seen_by(kind, row), C=row, R=model["R"][i, i], unit=unit, offset=offset, scale=scale)
        )
    return Plant(
        model["A"],
        model["Q"],
        sensors,
        B=model["B"],
        dt=1.0,
        state_names=[f"angle of bus {bus:.0f}" for bus in model["buses"] + 1],
        input_names=[f"scheduled {bus:.0f}" for bus in model["buses"] + 1],
        input_offset=BASE * model["u0"],
        input_scale=BASE,
        name="IEEE 14-bus grid",
    )


if __name__ == "__main__":
    plant().save(HERE / "plant.toml")

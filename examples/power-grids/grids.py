"""DC models of the IEEE 14-, 39-, 118- and 300-bus grids as plants.

    >>> dc_grid("case118")
    Plant('IEEE 118-bus grid', n=117, m=519, sensors=519, inputs=0, dt=1 s)

The state holds the voltage angles of all buses but the reference, in radians from the operating point. A
branch carries (angle here - angle there) / (x * tap), in per unit. A sensor is named by where it stands:
`flow 4-5` is at bus 4, `flow 5-4` at the other end of the same branch; `injection 8` and `angle 10` are at
buses 8 and 10. The second of two parallel branches is `flow 42-49 (2)`.
"""

from collections import Counter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from securestate import Plant, Sensor

HERE = Path(__file__).resolve().parent

#: The bus whose angle is zero, the slack bus of the case; the model has no column for it.
REFERENCE = {"case14": 1, "case39": 31, "case118": 69, "case300": 7049}

DECAY = 0.995  # of an angle in one second
DRIFT = 1.4e-6  # rad^2 per second; what the angles of the 14-bus example have on average
NOISE = {"flow": 0.01, "injection": 0.015, "angle": 0.001}  # standard deviations, p.u., p.u., rad
#: Draws the buses with an angle sensor; in the 14-bus grid they are 3, 4 and 10, as in the other example.
SEED = {"case14": 2024, "case39": 2024, "case118": 2, "case300": 2}

Array = NDArray[np.float64]
Buses = NDArray[np.int64]


def read_branches(case: str) -> tuple[Buses, Array]:
    """Return the buses at both ends of every branch (b, 2), and the branches' susceptances (b,)."""
    table = np.loadtxt(HERE / f"{case}.csv", delimiter=",", skiprows=1)
    x, tap = table[:, 2], table[:, 3]
    return table[:, :2].astype(np.int64), 1 / (x * np.where(tap == 0, 1.0, tap))


def angle_sensors(states: Buses, seed: int) -> Buses:
    """Draw the buses with an angle sensor, a quarter of all; the reference bus shows nothing and has none."""
    drawn = np.random.default_rng(seed).choice(len(states), (len(states) + 1) // 4, replace=False)
    return states[np.sort(drawn)]


def observation(ends: Buses, susceptance: Array, buses: Buses, measured: Buses) -> Array:
    """Return what all sensors see of the angles of all buses, (m, buses)."""
    at = np.eye(len(buses))
    start, end = at[np.searchsorted(buses, ends.T)]
    flows = susceptance[:, np.newaxis] * (start - end)
    injections = (start - end).T @ flows
    return np.vstack([flows, -flows, injections, at[np.searchsorted(buses, measured)]])


def flow_names(ends: Buses) -> list[str]:
    """Name the flows at the from ends of all branches, then those at the to ends."""
    seen: Counter[frozenset[int]] = Counter()
    here, there = [], []
    for start, end in ends.tolist():
        pair = frozenset((start, end))
        seen[pair] += 1
        which = f" ({seen[pair]})" if seen[pair] > 1 else ""
        here.append(f"flow {start}-{end}{which}")
        there.append(f"flow {end}-{start}{which}")
    return here + there


def sensor(name: str, row: Array) -> Sensor:
    kind = name.split()[0]
    return Sensor(name, C=row, R=NOISE[kind] ** 2, unit="rad" if kind == "angle" else "p.u.")


def dc_grid(case: str) -> Plant:
    """Return the DC model of "case14", "case39", "case118" or "case300".

    Its sensors, in this order: the active flow at the from end of every branch, at the to end of every
    branch, the injection of every bus, and the angle of a quarter of the buses.
    """
    if case not in REFERENCE:
        raise ValueError(f"case: expected one of {', '.join(REFERENCE)}, received {case!r}")
    ends, susceptance = read_branches(case)
    buses = np.unique(ends)
    states = buses[buses != REFERENCE[case]]
    measured = angle_sensors(states, SEED[case])
    C = observation(ends, susceptance, buses, measured)[:, buses != REFERENCE[case]]
    names = flow_names(ends)
    names += [f"injection {bus}" for bus in buses] + [f"angle {bus}" for bus in measured]
    return Plant(
        DECAY * np.eye(len(states)),
        DRIFT * np.eye(len(states)),
        [sensor(name, row) for name, row in zip(names, C, strict=True)],
        state_names=[f"angle of bus {bus}" for bus in states],
        name=f"IEEE {len(buses)}-bus grid",
    )

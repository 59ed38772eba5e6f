"""What a plant file says: sizes, sensors, modes, and which estimators it allows."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from rich.table import Table

from securestate._analysis_text import survives
from securestate.cli import console
from securestate.cli.exits import Exit
from securestate.cli.methods import design
from securestate.errors import DesignError, InsecureWarning, SecurestateWarning
from securestate.estimators import AUTO, DEFAULT, METHODS
from securestate.plant import Plant
from securestate.resilience import relevant, undetectable_modes, unobserved_modes

PATIENCE = 5.0  # seconds for the number of liars
MARGIN = 1e-9  # an eigenvalue this close to the unit circle is marginal


def inspect(path: Path) -> Exit:
    """Print what a plant file says; the exit code tells whether any estimator can be designed."""
    plant = Plant.load(path)
    verdicts = {name: _verdict(plant, name) for name in METHODS}
    shown = console.output()
    shown.print(f"{plant.name or path.name}: {_sizes(plant)}")
    shown.print()
    shown.print(_sensors(plant))
    shown.print()
    says = (f"Method {_called(name)}: {said}." for name, (_, said) in verdicts.items())
    for line in [*_modes(plant), *says, _liars(plant)]:
        shown.print(line)
    return Exit.CLEAN if any(usable for usable, _ in verdicts.values()) else Exit.DESIGN


def _called(name: str) -> str:
    return f"{name} ({AUTO})" if name == DEFAULT else name


def _sizes(plant: Plant) -> str:
    counts = {"state": plant.n, "sensor": plant.n_sensors, "channel": plant.m, "input": plant.n_inputs}
    said = ", ".join(f"{count} {thing}{'' if count == 1 else 's'}" for thing, count in counts.items())
    return f"{said}, one sample every {plant.dt:g} s"


def _sensors(plant: Plant) -> Table:
    headings = ["sensor", "channels", "unit", "noise (1 sigma)", "protected"]
    headings += [] if plant.verifiable.all() else ["verifiable"]
    grid = console.table(*headings, *([] if plant.time_varying else ["alone does not see"]))
    noise = plant.scale * np.sqrt(np.diag(plant.R))
    for i, sensor in enumerate(plant.sensors):
        own = plant.channels_of(i)
        cells = [
            sensor.name,
            "\n".join(plant.channel_names[own]),
            "\n".join(plant.units[own]),
            "\n".join(f"{deviation:.4g}" for deviation in noise[own]),
            "yes" if sensor.protected else "-",
        ]
        if not plant.verifiable.all():
            cells.append("yes" if sensor.verifiable else "no")
        if not plant.time_varying:
            cells.append("\n".join(map(str, unobserved_modes(plant, i))) or "-")
        grid.add_row(*cells)
    return grid


def _modes(plant: Plant) -> list[str]:
    if plant.time_varying:
        return [f"The plant varies in time over {plant.horizon} samples, so it has no fixed modes."]
    size = np.abs(np.linalg.eigvals(plant.A))
    stable, unstable = int(np.sum(size < 1 - MARGIN)), int(np.sum(size > 1 + MARGIN))
    hidden = undetectable_modes(plant)
    return [
        f"Modes: {stable} stable, {len(size) - stable - unstable} marginal, {unstable} unstable; "
        f"largest |eigenvalue| {size.max():.6g}.",
        "Detectable: " + (f"no, no sensor sees {', '.join(map(str, hidden))}." if hidden else "yes."),
    ]


def _liars(plant: Plant) -> str:
    if plant.time_varying:
        return f"At most {(plant.n_sensors - 1) // 2} of {plant.n_sensors} sensors can be outvoted."
    found = relevant(plant, time_limit=PATIENCE)
    return f"The plant {survives(found)}; `securestate analyse` says where it is weak and what would help."


def _verdict(plant: Plant, name: str) -> tuple[bool, str]:
    """Whether a method can be designed, and what there is to say about it."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", SecurestateWarning)
        try:
            design(plant, name, {})
        except DesignError as reason:
            return False, f"cannot be used: {reason}"
    insecure = [str(warning.message) for warning in told if issubclass(warning.category, InsecureWarning)]
    return True, "; ".join(["can be used", *(f"but {reason}" for reason in insecure)])

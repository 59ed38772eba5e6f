"""What a model was learned from, and its motions as times."""

from __future__ import annotations

import math
import os
from typing import TYPE_CHECKING

import numpy as np

from securestate._words import count
from securestate.reporting.clock import UNITS
from securestate.reporting.comparison_tables import scroll
from securestate.reporting.identification_tables import portion
from securestate.reporting.page import compact, definitions, table

if TYPE_CHECKING:
    from securestate.identification import Identified


def facts(found: Identified, source: str | os.PathLike[str] | None) -> str:
    """What it was learned from, and what came out."""
    plant, judged = found.plant, found.verdict.residuals
    values = np.linalg.eigvals(plant.A)
    largest = float(np.max(np.abs(values), initial=0.0))
    every = "" if plant.dt == 1.0 else f" of {_seconds(plant.dt)} ({_seconds(found.samples * plant.dt)})"
    parts = sum(len(part) > 0 for part in judged.segments)
    climb = found.likelihoods
    return definitions(
        {
            "Learned from": f"{count(found.samples, 'sample')}{every}",
            "Judged by": count(judged.samples, "sample") + (f" in {parts} segments" if parts > 1 else ""),
            "Readings missing": portion(found.missing) if found.missing else "none",
            "Sensors": f"{plant.n_sensors:,}"
            + (f" with {plant.m} channels" if plant.m > plant.n_sensors else ""),
            "Inputs": f"{plant.n_inputs:,}" if plant.n_inputs else "none",
            "States": f"{plant.n:,}",
            "Largest |eigenvalue| of A": f"{largest:.4f}",
            "Slowest time constant": constant(largest, plant.dt),
            "Past used": count(found.search.past, "sample"),
            "Likelihood of the last fit": f"{climb[0]:.3f} → {climb[-1]:.3f} nats per sample".replace(
                "-", "−"
            )
            if climb
            else "",
            "Noise of the plant": f"raised {raised(found.noise_factor)}"
            if found.noise_factor != 1
            else "as fitted",
            "Source": "" if source is None else os.fspath(source),
        }
    )


def raised(factor: float) -> str:
    """By how much.

    Examples:
        >>> raised(1.114), raised(461332.2)
        ('by 11 %', '461,332 times')
    """
    return f"by {100 * (factor - 1):.0f} %" if factor < 2 else f"{factor:,.{0 if factor > 10 else 1}f} times"


def modes(found: Identified) -> str:
    """Every mode of the plant with its time constant, the slowest first; pairs once."""
    plant = found.plant
    values = [v for v in np.linalg.eigvals(plant.A).tolist() if complex(v).imag >= 0]
    rows = (_mode(complex(v), plant.dt) for v in sorted(values, key=lambda v: -abs(v)))
    return scroll(table(("Eigenvalue", "Size", "Time constant", "Period"), rows), "Modes")


def _mode(value: complex, dt: float) -> str:
    turn = abs(math.atan2(value.imag, value.real))
    name = f"{value.real:.4f}" + (f" ± {value.imag:.4f} i" if value.imag else "")
    period = duration(2 * math.pi * dt / turn, dt) if value.imag else "–"
    return (
        f'<tr><th scope="row">{name.replace("-", "−")}</th><td>{abs(value):.4f}</td>'
        f"<td>{constant(abs(value), dt)}</td><td>{period}</td></tr>"
    )


def constant(size: float, dt: float) -> str:
    """The time in which a mode falls to 1/e."""
    if size >= 1:
        return "never fades"
    return duration(-dt / math.log(size), dt) if size > 0 else "–"


def duration(seconds: float, dt: float) -> str:
    """A time as a reader wants it; in samples if the sample time is 1, as of a record without times.

    Examples:
        >>> duration(430, 180), duration(9000, 180), duration(0.02, 0.01), duration(12.3, 1.0)
        ('7.17 min', '2.50 h', '0.0200 s', '12.3 samples')
    """
    return f"{compact(seconds)} samples" if dt == 1.0 else _seconds(seconds, 3)


def _seconds(seconds: float, digits: int = 0) -> str:
    unit, length = next(((u, s) for u, s, _ in UNITS if seconds >= 2 * s), ("s", 1.0))
    value = seconds / length
    return f"{compact(value)} {unit}" if digits else f"{value:,.4g} {unit}"

"""What the report's script gets: the run's arrays packed at full resolution, and the names they go by."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from securestate.reporting.clock import Clock
from securestate.reporting.payload import Block, pack, pack_bytes

if TYPE_CHECKING:
    from securestate.estimators.run import Run
    from securestate.plant import Plant
    from securestate.reporting.summary import Summary

BOUND = 3.0
"""Normalised innovations beyond ± BOUND are rare (0.27 %) when the model holds and nobody lies."""

SMALLEST_GAP = 1e-18
"""The gap at the end of an iteration is drawn as a power of ten; zero is drawn here."""

Packed = dict[str, tuple[dict[str, object], str]]


def pack_run(run: Run, clock: Clock, beside: Run | None = None) -> Packed:
    """Every array the report draws, by name: a description for the script, and the text."""
    noise = _typical(run.innovation_std)
    spread = _typical(run.x_std)
    blocks = {
        "trust": pack(run.trust, 1 / 250),
        "suspected": pack(run.suspected.astype(np.float64), 1.0, delta=True),
        "ratio": pack(normalised_innovation(run), 0.02),
        "attack": pack(run.attack, noise / 100, delta=True),
        "x": pack(run.x, spread / 100, delta=True),
        "x_std": pack(run.x_std, spread / 100, delta=True),
        "status": pack(run.status[:, None].astype(np.float64), 1.0, delta=True),
    }
    if beside is not None:
        blocks["beside"] = pack(beside.x, spread / 100, delta=True)
    if run.diagnostics:
        blocks["diagnostics"] = pack(np.column_stack(list(diagnostics(run).values())))
    packed: Packed = {name: (_describe(block), block.text) for name, block in blocks.items()}
    if clock.regular is None:
        packed["time"] = ({"rows": clock.values.size}, pack_bytes(clock.values.astype("<f8").tobytes()))
    return packed


def normalised_innovation(run: Run) -> NDArray[np.float64]:
    """Innovation over its standard deviation, (T, m); NaN where one is missing or the deviation is zero."""
    scale = np.where(run.innovation_std > 0, run.innovation_std, np.nan)
    ratio: NDArray[np.float64] = run.innovation / scale
    return ratio


def channel_labels(plant: Plant) -> list[str]:
    """What a channel is called in charts: the only channel of a sensor goes by the sensor's name."""
    alone = np.bincount(plant.channel_sensor, minlength=plant.n_sensors) == 1
    owners = zip(plant.channel_names, plant.channel_sensor, strict=True)
    return [plant.sensor_names[owner] if alone[owner] else name for name, owner in owners]


def channel_noise(plant: Plant) -> NDArray[np.float64]:
    """Standard deviation of the measurement noise of every channel, (m,), file units."""
    noise: NDArray[np.float64] = plant.scale * np.sqrt(np.diagonal(plant.R))
    return noise


def diagnostics(run: Run) -> dict[str, NDArray[np.float64]]:
    """The diagnostics as they are drawn, by title; the gap as a power of ten."""
    drawn = {}
    for name, values in run.diagnostics.items():
        if name == "gap":
            what = "duality gap" if "fast_path" in run.diagnostics else "last change"
            drawn[f"{what}, power of ten"] = np.log10(np.maximum(values, SMALLEST_GAP))
        else:
            drawn[name.replace("_", " ")] = values
    return drawn


def manifest(run: Run, summary: Summary, clock: Clock, blocks: Packed) -> dict[str, object]:
    """Names, units and layout for the script; everything in it is plain JSON."""
    plant = run.plant
    return {
        "samples": summary.samples,
        "time": {"unit": clock.unit, "decimals": clock.decimals, "regular": clock.regular},
        "bound": BOUND,
        "sensors": [
            {"name": s.name, "lies": s.lies, "share": s.suspected, "uncheckable": s.uncheckable}
            for s in summary.sensors
        ],
        "channels": [
            {"label": label, "unit": unit, "sensor": int(owner), "noise": float(noise)}
            for label, unit, owner, noise in zip(
                channel_labels(plant), plant.units, plant.channel_sensor, channel_noise(plant), strict=True
            )
        ],
        "states": list(plant.state_names),
        "diagnostics": list(diagnostics(run)),
        "blocks": {name: description for name, (description, _) in blocks.items()},
    }


def _describe(block: Block) -> dict[str, object]:
    return {
        "rows": block.rows,
        "columns": block.columns,
        "delta": block.delta,
        "offset": block.offset,
        "step": block.step,
    }


def _typical(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """A typical value per column: the median of a thousand samples across the run; 0 where there is none."""
    sample = values[:: max(1, values.shape[0] // 1000)]
    sample = np.where(np.isfinite(sample), sample, np.nan)
    present = ~np.isnan(sample).all(axis=0)
    typical = np.zeros(values.shape[1])
    typical[present] = np.nanmedian(sample[:, present], axis=0)
    return typical

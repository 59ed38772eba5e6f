"""What every method with protected sensors says at design time."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import NDArray

from securestate.errors import SecurestateWarning
from securestate.plant import Plant
from securestate.resilience.detectability import undetectable_modes

#: An injection's variance below this share of its channel's noise is hardly looked for.
SMALL = 1e-2


def warn_of_hidden_modes(plant: Plant, stacklevel: int = 3) -> None:
    """Warn of what the protected sensors leave undetectable; nothing for a plant that varies."""
    if plant.time_varying or plant.protected.all():
        return
    hidden = undetectable_modes(plant.select(np.flatnonzero(plant.protected).tolist()))
    if hidden:
        named = ", ".join(map(str, hidden))
        warnings.warn(
            f"the protected sensors do not see {named}: a lie of the others that moves along it is "
            "invisible, and so is its effect on the state",
            SecurestateWarning,
            stacklevel=stacklevel + 1,
        )


def warn_of_small(
    plant: Plant, argument: str, channels: NDArray[np.int64], variances: NDArray[np.float64], advice: str
) -> None:
    """Warn of the first channel whose assumed injection is far below its own noise, but not zero.

    Args:
        variances: in the units of C x, one per channel in `channels`.
        advice: what to do.
    """
    noise = np.diag(plant.R)[channels]
    for channel, variance, own in zip(channels, variances, noise, strict=True):
        if 0 < variance < SMALL * own:
            unit, scale = plant.units[channel], float(plant.scale[channel]) ** 2
            unit = f" ({unit})²" if unit else ""
            warnings.warn(
                f"{argument} is {variance * scale:.3g}{unit} for {plant.channel_names[channel]!r}, far below "
                f"the variance {own * scale:.3g}{unit} of its noise: larger injections pass as the state; "
                f"{advice}",
                SecurestateWarning,
                stacklevel=4,
            )
            return

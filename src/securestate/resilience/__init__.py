"""What can be said about a plant and its sensors before any data."""

from securestate.resilience.detectability import (
    Mode,
    modes,
    undetectable_modes,
    unobserved_modes,
    unreachable_noise_modes,
)
from securestate.resilience.margin import Margin, margin

__all__ = [
    "Margin",
    "Mode",
    "margin",
    "modes",
    "undetectable_modes",
    "unobserved_modes",
    "unreachable_noise_modes",
]

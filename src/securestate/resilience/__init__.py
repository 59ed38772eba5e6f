"""What can be said about a plant and its sensors before any data."""

from securestate.resilience.detectability import (
    Mode,
    undetectable_modes,
    unobserved_modes,
    unreachable_noise_modes,
)

__all__ = ["Mode", "undetectable_modes", "unobserved_modes", "unreachable_noise_modes"]

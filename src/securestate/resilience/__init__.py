"""What can be said about a plant and its sensors before any data."""

from securestate.resilience.advice import Option, options, smallest_protection
from securestate.resilience.detectability import (
    Mode,
    detectability_margin,
    modes,
    undetectable_modes,
    unobserved_modes,
    unreachable_noise_modes,
)
from securestate.resilience.fusion_margin import FusionMargin
from securestate.resilience.lie import Lie
from securestate.resilience.limit import Limit, ModeLimit, limit, profile, relevant
from securestate.resilience.margin import Margin, margin
from securestate.resilience.visibility import Visibility, visibility

__all__ = [
    "FusionMargin",
    "Lie",
    "Limit",
    "Margin",
    "Mode",
    "ModeLimit",
    "Option",
    "Visibility",
    "detectability_margin",
    "limit",
    "margin",
    "modes",
    "options",
    "profile",
    "relevant",
    "smallest_protection",
    "undetectable_modes",
    "unobserved_modes",
    "unreachable_noise_modes",
    "visibility",
]

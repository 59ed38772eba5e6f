"""Adversaries: one file each, what they all share in `base`, whom they control in `targets`."""

from securestate.attacks.base import Attack, Knowledge
from securestate.attacks.bias import Bias
from securestate.attacks.targets import Drawn, Fixed, Redrawn, Switching, Targets

__all__ = ["Attack", "Bias", "Drawn", "Fixed", "Knowledge", "Redrawn", "Switching", "Targets"]

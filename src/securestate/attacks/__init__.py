"""Adversaries: one file each, what they all share in `base`, whom they control in `targets`."""

from securestate.attacks.base import Attack
from securestate.attacks.bias import Bias
from securestate.attacks.delay import Delay
from securestate.attacks.denial import Denial
from securestate.attacks.fake_state import FakeState
from securestate.attacks.freeze import Freeze
from securestate.attacks.knowledge import Knowledge
from securestate.attacks.noise_linear import NoiseLinear
from securestate.attacks.pulse import Pulse
from securestate.attacks.ramp import Ramp
from securestate.attacks.random_noise import RandomNoise
from securestate.attacks.random_walk import RandomWalk
from securestate.attacks.reflection import DefenderReflection, Reflection
from securestate.attacks.registry import ATTACKS
from securestate.attacks.replay import Replay
from securestate.attacks.scale import Scale
from securestate.attacks.sinusoid import Sinusoid
from securestate.attacks.targets import Cycle, Drawn, Fixed, Redrawn, Switching, Targets
from securestate.attacks.worst_case import WorstCase
from securestate.attacks.zero_dynamics import ZeroDynamics

__all__ = [
    "ATTACKS",
    "Attack",
    "Bias",
    "Cycle",
    "DefenderReflection",
    "Delay",
    "Denial",
    "Drawn",
    "FakeState",
    "Fixed",
    "Freeze",
    "Knowledge",
    "NoiseLinear",
    "Pulse",
    "Ramp",
    "RandomNoise",
    "RandomWalk",
    "Redrawn",
    "Reflection",
    "Replay",
    "Scale",
    "Sinusoid",
    "Switching",
    "Targets",
    "WorstCase",
    "ZeroDynamics",
]

"""All adversaries by the short names that configuration files use."""

from collections.abc import Mapping
from types import MappingProxyType

from securestate.attacks.base import SingleAttack
from securestate.attacks.bias import Bias
from securestate.attacks.delay import Delay
from securestate.attacks.denial import Denial
from securestate.attacks.fake_state import FakeState
from securestate.attacks.freeze import Freeze
from securestate.attacks.noise_linear import NoiseLinear
from securestate.attacks.pulse import Pulse
from securestate.attacks.ramp import Ramp
from securestate.attacks.random_noise import RandomNoise
from securestate.attacks.random_walk import RandomWalk
from securestate.attacks.reflection import DefenderReflection, Reflection
from securestate.attacks.replay import Replay
from securestate.attacks.scale import Scale
from securestate.attacks.sinusoid import Sinusoid
from securestate.attacks.worst_case import WorstCase
from securestate.attacks.zero_dynamics import ZeroDynamics

#: Every adversary exactly once.
ATTACKS: Mapping[str, type[SingleAttack]] = MappingProxyType(
    {
        "bias": Bias,
        "defender-reflection": DefenderReflection,
        "delay": Delay,
        "denial": Denial,
        "fake-state": FakeState,
        "freeze": Freeze,
        "noise-linear": NoiseLinear,
        "pulse": Pulse,
        "ramp": Ramp,
        "random-noise": RandomNoise,
        "random-walk": RandomWalk,
        "reflection": Reflection,
        "replay": Replay,
        "scale": Scale,
        "sinusoid": Sinusoid,
        "worst-case": WorstCase,
        "zero-dynamics": ZeroDynamics,
    }
)

"""All methods by name. A method that is registered here is offered wherever methods are chosen by name."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import final

from securestate.estimators.adaptive_joint import AdaptiveJointFilter
from securestate.estimators.adaptive_kalman import AdaptiveKalman
from securestate.estimators.augmented_kalman import AugmentedKalman
from securestate.estimators.base import Estimator
from securestate.estimators.bias_monitor import BiasMonitor
from securestate.estimators.chi_square import ChiSquareFilter
from securestate.estimators.innovation_gate import InnovationGate
from securestate.estimators.innovation_mixture import InnovationMixture
from securestate.estimators.joint_fusion import JointFusion
from securestate.estimators.kalman import KalmanFilter
from securestate.estimators.mixture_fusion import MixtureFusion
from securestate.estimators.protected_kalman import ProtectedKalman
from securestate.estimators.secure_filter import SecureFilter
from securestate.estimators.sparse_fusion import SparseFusion


@final
@dataclass(frozen=True)
class Method:
    """One way to estimate.

    Attributes:
        design: makes the estimator of a plant; settings are keywords.
        summary: what it does, one line without a full stop.
        beside: name of the method that comparisons always show beside it; empty: none.
    """

    design: Callable[..., Estimator]
    summary: str
    beside: str = ""

    @property
    def settings(self) -> tuple[str, ...]:
        """Names of the settings that `design` takes: all its parameters but the first, the plant."""
        return tuple(inspect.signature(self.design).parameters)[1:]


#: The name that stands for the method to try first, and which one that is.
AUTO = "auto"
DEFAULT = "secure"

#: Every method by the name that users type, the one to try first in front.
METHODS: Mapping[str, Method] = MappingProxyType(
    {
        "secure": Method(SecureFilter, "finds lying sensors, remembers them, and says what they inject"),
        "sparse": Method(SparseFusion, "finds lying sensors"),
        "innovation-mixture": Method(
            InnovationMixture, "weighs readings by the belief that they are honest; liars may change"
        ),
        "kalman": Method(KalmanFilter, "trusts every sensor"),
        "adaptive-joint": Method(
            AdaptiveJointFilter, "judges sensors by those that are protected", "protected"
        ),
        "joint": Method(
            JointFusion, "estimates injections with the state, by protected sensors", "protected"
        ),
        "protected": Method(ProtectedKalman, "hears protected sensors only"),
        "mixture": Method(MixtureFusion, "clusters what every sensor alone says of the state"),
        "gate": Method(InnovationGate, "leaves out readings far from the common prediction"),
        "bias-monitor": Method(BiasMonitor, "gathers evidence for small constant biases"),
        "chi-square": Method(ChiSquareFilter, "leaves out sensors that surprise their own filter"),
        "augmented": Method(AugmentedKalman, "takes attacks on sensors that are not protected for states"),
        "adaptive-kalman": Method(AdaptiveKalman, "the same with attacks that drift at a constant rate"),
    }
)

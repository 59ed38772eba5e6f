"""Estimators: one file per algorithm, the protocol in `base`, all of them by name in `registry`."""

from securestate._kernels import Estimate
from securestate.estimators.adaptive_joint import AdaptiveJointFilter
from securestate.estimators.adaptive_kalman import AdaptiveKalman
from securestate.estimators.augmented_kalman import AugmentedKalman
from securestate.estimators.base import Estimator, Filter, Status
from securestate.estimators.bias_monitor import BiasMonitor
from securestate.estimators.chi_square import ChiSquareFilter
from securestate.estimators.cold_start import ColdStart, cold_start
from securestate.estimators.innovation_gate import InnovationGate
from securestate.estimators.innovation_mixture import InnovationMixture
from securestate.estimators.joint_fusion import JointFusion, JointMoments
from securestate.estimators.kalman import KalmanFilter
from securestate.estimators.mixture_fusion import MixtureFusion
from securestate.estimators.oracle import OracleFilter
from securestate.estimators.protected_kalman import ProtectedKalman
from securestate.estimators.registry import AUTO, DEFAULT, METHODS, Method
from securestate.estimators.run import Run
from securestate.estimators.secure_filter import SecureFilter
from securestate.estimators.sparse_fusion import SparseFusion
from securestate.estimators.window_run import start_after, window_run

__all__ = [
    "AUTO",
    "DEFAULT",
    "METHODS",
    "AdaptiveJointFilter",
    "AdaptiveKalman",
    "AugmentedKalman",
    "BiasMonitor",
    "ChiSquareFilter",
    "ColdStart",
    "Estimate",
    "Estimator",
    "Filter",
    "InnovationGate",
    "InnovationMixture",
    "JointFusion",
    "JointMoments",
    "KalmanFilter",
    "Method",
    "MixtureFusion",
    "OracleFilter",
    "ProtectedKalman",
    "Run",
    "SecureFilter",
    "SparseFusion",
    "Status",
    "cold_start",
    "start_after",
    "window_run",
]

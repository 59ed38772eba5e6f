"""Estimators: one file per algorithm, the protocol in `base`."""

from securestate._kernels import Estimate
from securestate.estimators.base import Estimator, Filter, Status
from securestate.estimators.kalman import KalmanFilter
from securestate.estimators.run import Run
from securestate.estimators.sparse_fusion import SparseFusion

__all__ = ["Estimate", "Estimator", "Filter", "KalmanFilter", "Run", "SparseFusion", "Status"]

"""Estimate the state of a plant from many sensors while some of them lie, and name the liars."""

from securestate import attacks
from securestate.errors import (
    DesignError,
    InputError,
    MeasurementError,
    PlantError,
    ResumeError,
    SecurestateError,
    SecurestateWarning,
    ShapeError,
)
from securestate.estimators import (
    AdaptiveKalman,
    AugmentedKalman,
    ChiSquareFilter,
    Estimate,
    Estimator,
    Filter,
    InnovationGate,
    KalmanFilter,
    OracleFilter,
    Run,
    SparseFusion,
    Status,
)
from securestate.measurements import Measurements, read_measurements, write_run
from securestate.plant import Belief, Plant, Sensor
from securestate.simulation import Comparison, Trajectory, compare, simulate

__all__ = [
    "AdaptiveKalman",
    "AugmentedKalman",
    "Belief",
    "ChiSquareFilter",
    "Comparison",
    "DesignError",
    "Estimate",
    "Estimator",
    "Filter",
    "InnovationGate",
    "InputError",
    "KalmanFilter",
    "MeasurementError",
    "Measurements",
    "OracleFilter",
    "Plant",
    "PlantError",
    "ResumeError",
    "Run",
    "SecurestateError",
    "SecurestateWarning",
    "Sensor",
    "ShapeError",
    "SparseFusion",
    "Status",
    "Trajectory",
    "attacks",
    "compare",
    "read_measurements",
    "simulate",
    "write_run",
]

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

__all__ = [
    "Belief",
    "ChiSquareFilter",
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
    "attacks",
    "read_measurements",
    "write_run",
]

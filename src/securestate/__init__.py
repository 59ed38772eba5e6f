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
from securestate.estimators import Estimate, Estimator, Filter, KalmanFilter, Run, SparseFusion, Status
from securestate.measurements import Measurements, read_measurements, write_run
from securestate.plant import Belief, Plant, Sensor

__all__ = [
    "Belief",
    "DesignError",
    "Estimate",
    "Estimator",
    "Filter",
    "InputError",
    "KalmanFilter",
    "MeasurementError",
    "Measurements",
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

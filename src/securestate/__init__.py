"""Estimate the state of a plant from many sensors while some of them lie, and name the liars."""

from securestate.errors import (
    DesignError,
    InputError,
    MeasurementError,
    PlantError,
    ResumeError,
    SecurestateError,
    ShapeError,
)
from securestate.plant import Belief, Plant, Sensor

__all__ = [
    "Belief",
    "DesignError",
    "InputError",
    "MeasurementError",
    "Plant",
    "PlantError",
    "ResumeError",
    "SecurestateError",
    "Sensor",
    "ShapeError",
]

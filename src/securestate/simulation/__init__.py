"""Simulate a plant under attack, and compare estimators on it."""

from securestate.simulation.simulate import Simulator, simulate
from securestate.simulation.stabilise import stabilised
from securestate.simulation.trajectory import Trajectory

__all__ = ["Simulator", "Trajectory", "simulate", "stabilised"]

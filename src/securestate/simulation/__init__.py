"""Simulate a plant under attack, and compare estimators on it."""

from securestate.simulation.compare import campaign, compare
from securestate.simulation.comparison import Comparison
from securestate.simulation.falsify import Falsified, falsify
from securestate.simulation.families import FAMILIES, PlantFamily
from securestate.simulation.scenario import Recipe, Scenario
from securestate.simulation.simulate import Simulator, simulate
from securestate.simulation.stabilise import stabilised
from securestate.simulation.trajectory import Trajectory

__all__ = [
    "FAMILIES",
    "Comparison",
    "Falsified",
    "PlantFamily",
    "Recipe",
    "Scenario",
    "Simulator",
    "Trajectory",
    "campaign",
    "compare",
    "falsify",
    "simulate",
    "stabilised",
]

"""A plant from attack-free history, with an honest verdict on the fit."""

from securestate.identification.history import History
from securestate.identification.identify import Identified, identify
from securestate.identification.judge import SensorEvidence, Verdict, judge
from securestate.identification.verdict import Grade, Problem

__all__ = ["Grade", "History", "Identified", "Problem", "SensorEvidence", "Verdict", "identify", "judge"]

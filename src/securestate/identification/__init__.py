"""A plant from attack-free history, with an honest verdict on the fit."""

from securestate.identification.history import History
from securestate.identification.identified import Identified
from securestate.identification.identify import identify
from securestate.identification.judge import SensorEvidence, Verdict, judge
from securestate.identification.refine import Refined, refine
from securestate.identification.verdict import Criterion, Grade, Problem

__all__ = [
    "Criterion",
    "Grade",
    "History",
    "Identified",
    "Problem",
    "Refined",
    "SensorEvidence",
    "Verdict",
    "identify",
    "judge",
    "refine",
]

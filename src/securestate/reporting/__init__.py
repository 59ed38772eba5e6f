"""What an engineer wants to see: a run in numbers, and a run or a comparison in one HTML file."""

from securestate.reporting.comparison import write_comparison
from securestate.reporting.html import write_report
from securestate.reporting.summary import Injection, Moment, SensorSummary, StatusCount, Summary, summarise

__all__ = [
    "Injection",
    "Moment",
    "SensorSummary",
    "StatusCount",
    "Summary",
    "summarise",
    "write_comparison",
    "write_report",
]

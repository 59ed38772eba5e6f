"""What an engineer wants to see: a run in numbers; a run, comparison, analysis or model in one HTML file."""

from securestate.reporting.comparison import write_comparison
from securestate.reporting.html import write_report
from securestate.reporting.identification import write_identification
from securestate.reporting.resilience import write_resilience
from securestate.reporting.summary import Injection, Moment, SensorSummary, StatusCount, Summary, summarise

__all__ = [
    "Injection",
    "Moment",
    "SensorSummary",
    "StatusCount",
    "Summary",
    "summarise",
    "write_comparison",
    "write_identification",
    "write_report",
    "write_resilience",
]

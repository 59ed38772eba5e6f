"""A run as an engineer wants it: a summary in numbers, and a report in one HTML file."""

from securestate.reporting.html import write_report
from securestate.reporting.summary import Injection, Moment, SensorSummary, StatusCount, Summary, summarise

__all__ = ["Injection", "Moment", "SensorSummary", "StatusCount", "Summary", "summarise", "write_report"]

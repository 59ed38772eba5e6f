"""What an engineer wants to see: a run in numbers; a run, comparison, analysis or model in one HTML file."""

from securestate.reporting.clock import Moment
from securestate.reporting.comparison import write_comparison
from securestate.reporting.courses import Course, Kind
from securestate.reporting.findings import Alarms, Crowd, Finding, Findings, find
from securestate.reporting.findings_file import write_findings
from securestate.reporting.html import write_report
from securestate.reporting.identification import write_identification
from securestate.reporting.periods import Period
from securestate.reporting.resilience import write_resilience
from securestate.reporting.summary import Injection, SensorSummary, StatusCount, Summary, summarise

__all__ = [
    "Alarms",
    "Course",
    "Crowd",
    "Finding",
    "Findings",
    "Injection",
    "Kind",
    "Moment",
    "Period",
    "SensorSummary",
    "StatusCount",
    "Summary",
    "find",
    "summarise",
    "write_comparison",
    "write_findings",
    "write_identification",
    "write_report",
    "write_resilience",
]

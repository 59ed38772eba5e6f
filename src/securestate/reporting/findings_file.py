"""The findings of a run in a file that programs read: JSON, whole or not at all."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from securestate.reporting.clock import Clock, Moment
from securestate.reporting.findings import Crowd, Finding
from securestate.reporting.page import write_page
from securestate.reporting.periods import Period
from securestate.reporting.summary import summarise
from securestate.reporting.telling import crowded, period, what

if TYPE_CHECKING:
    from securestate.estimators.run import Run


def write_findings(
    run: Run,
    path: str | os.PathLike[str],
    *,
    source: str | os.PathLike[str] | None = None,
    notes: Sequence[str] = (),
) -> Path:
    """Write the findings of one run as JSON; an existing file is replaced when the new one is complete.

    The file holds "plant", "estimator", "settings", "source", "samples", "verdict", "liars", and:

    - "findings": what matters most first; "text" is the sentence that the terminal shows. A moment is
      {"sample": its number, "time": seconds or ISO 8601, null without times}. Unknown numbers are null.
    - "together": stretches in which at least half of the sensors were suspected at once.
    - "alarms": those that are no finding.
    - "periods": samples with a status other than OK.
    - "notes": what else there is to say, such as how a cold start went.

    Args:
        run: one run, x of shape (T, n).
        path: where to write.
        source: where the measurements came from, kept as given.
        notes: sentences, kept as given.
    Returns:
        The path written.
    Raises:
        InputError: names `run` if it is a batch of runs or holds no sample.
        OSError: the file cannot be written; nothing is left behind.
    """
    summary, clock = summarise(run), Clock.of(run)
    findings = summary.findings
    alarms = asdict(findings.alarms)
    alarms |= {name: dict(alarms[name]) for name in ("frequent", "at_start")}
    content = {
        "plant": summary.plant,
        "estimator": summary.estimator,
        "settings": {name: _plain(value) for name, value in run.settings.items()},
        "source": None if source is None else os.fspath(source),
        "samples": summary.samples,
        "verdict": summary.verdict,
        "liars": list(summary.liars),
        "findings": [_finding(f, clock) for f in findings.found],
        "together": [_crowd(c, clock) for c in findings.crowds],
        "alarms": alarms,
        "periods": [_period(p, clock) for p in findings.periods],
        "notes": list(notes),
    }
    text = json.dumps(_known(content), ensure_ascii=False, allow_nan=False, indent=1)
    return write_page(f"{text}\n", path)


def _finding(f: Finding, clock: Clock) -> dict[str, Any]:
    courses = [asdict(c) | {"kind": c.kind.value, "clear": c.clear} for c in f.courses]
    return {
        "sensor": f.sensor,
        "verdict": f.verdict,
        "since": _moment(f.since),
        "until": _moment(f.until),
        "ongoing": f.ongoing,
        "suspected": f.suspected,
        "sent": f.sent,
        "expected_by_chance": f.expected,
        "trust": f.trust,
        "certainty": f.certainty,
        "injections": courses,
        "text": f"{f.sensor} {what(f, clock)}",
    }


def _crowd(c: Crowd, clock: Clock) -> dict[str, Any]:
    return {
        "since": _moment(c.since),
        "until": _moment(c.until),
        "sensors": list(c.sensors),
        "persistent": c.persistent,
        "text": crowded(c, clock),
    }


def _period(p: Period, clock: Clock) -> dict[str, Any]:
    return {
        "status": p.status,
        "samples": p.samples,
        "stretches": [[_moment(since), _moment(until)] for since, until in p.stretches],
        "text": period(p, clock),
    }


def _moment(moment: Moment) -> dict[str, Any]:
    time = moment.time
    if isinstance(time, np.datetime64):
        return {"sample": moment.index, "time": str(np.datetime_as_string(time, unit="auto"))}
    return {"sample": moment.index, "time": None if time is None else float(time)}


def _plain(value: object) -> object:
    """A setting as JSON holds it."""
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)


def _known(value: Any) -> Any:
    """The same with null for numbers that are not finite."""
    if isinstance(value, dict):
        return {name: _known(inner) for name, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_known(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value

"""Findings in sentences: who lies, from when to when, how much, how sure; and when not to believe a run."""

from __future__ import annotations

import math
from collections.abc import Iterator

from securestate._words import count, enumerate_names
from securestate.reporting.clock import Clock, Moment
from securestate.reporting.courses import Course, Kind
from securestate.reporting.findings import START, Alarms, Crowd, Finding, Findings
from securestate.reporting.periods import Period

TOLD = 12
"""Findings that are told in sentences; of more the rest is counted."""


def sentences(findings: Findings, clock: Clock) -> Iterator[str]:
    """Everything a run says of its sensors, what matters most first."""
    for crowd in findings.crowds:
        yield crowded(crowd, clock)
    told = [f for f in findings.found if not f.together]
    for finding in told[:TOLD]:
        yield f"{finding.sensor} {what(finding, clock)}"
    if len(told) > TOLD:
        yield f"And {count(len(told) - TOLD, 'further finding')}, each smaller or less certain."
    yield from remarks(findings.alarms)


def what(finding: Finding, clock: Clock) -> str:
    """What a sensor did, the sentence that goes on after its name."""
    details = "; ".join([*amounts(finding, clock), sureness(finding)])
    if finding.lies:
        return f"{finding.verdict} {when(finding, clock)}: {details}."
    alarms = f"raised {count(finding.suspected, 'alarm')} {when(finding, clock)}"
    few = "too many others did" if finding.together else "too faint" if finding.faint else "too few"
    return f"{alarms}, {few} to say that it lies: {details}."


def when(finding: Finding, clock: Clock) -> str:
    """From when to when, with sample numbers."""
    return stretch(finding.since, finding.until, clock, ongoing=finding.ongoing and finding.persistent)


def stretch(since: Moment, until: Moment, clock: Clock, *, ongoing: bool = False) -> str:
    """From when to when, with sample numbers."""
    first, last = since.index, until.index
    if ongoing:
        return f"since {clock.moment(first)}, still at the end"
    if first == last:
        return f"at {clock.moment(first)}"
    if clock.unit == "sample":
        return f"from sample {first} to {last}"
    return f"from {clock.text(first)} to {clock.text(last)} (samples {first} to {last})"


def amounts(finding: Finding, clock: Clock) -> Iterator[str]:
    """How much a sensor adds, one phrase for each channel that has an estimate."""
    for c in finding.courses:
        if c.known:
            channel = f"{c.channel}: " if len(finding.courses) > 1 else ""
            yield f"{channel}{amount(c, clock)}"


def amount(c: Course, clock: Clock | None = None) -> str:
    """How much is added to a channel, and how that goes on.

    Examples:
        >>> level = Course("flow", "l/s", Kind.CONSTANT, 2.0, 2.0, 2.0, 0.1, 0.0, None, 1.0, 1.0)
        >>> amount(level)
        'about +2.00 ± 0.10 l/s, constant'
        >>> amount(Course("flow", "l/s", Kind.GROWING, 0.0, 5.0, 5.0, 0.1, 0.05, None, 1.0, 1.0))
        'growing by 0.05 l/s per sample, from 0.00 to +5.00 ± 0.10 l/s'
    """
    value = typical(c)
    if c.kind is Kind.ERRATIC:
        return value
    if c.kind in (Kind.GROWING, Kind.SETTLING):
        how = "growing" if abs(c.last) >= abs(c.first) else "shrinking"
        step = f"{plain(abs(c.slope))} {c.unit}".rstrip()
        first = measured(c.first, c.spread).split(" ± ")[0]
        if not any(digit in first for digit in "123456789"):
            first = first.lstrip("+−")
        then = "" if c.settled is None else f"until {_at(c.settled, clock)}, then constant"
        return ", ".join(filter(None, [f"{how} by {step} per sample", f"from {first} to {value}", then]))
    course = ", constant" if c.kind is Kind.CONSTANT else ""
    return f"about {value}{course}"


def _at(sample: int, clock: Clock | None) -> str:
    return f"sample {sample}" if clock is None else clock.moment(sample)


def typical(c: Course) -> str:
    """What is added to a channel at the end, with its scatter, or how large what is erratic is."""
    if c.kind is Kind.ERRATIC:
        return f"erratic, {plain(c.size)} {c.unit}".rstrip() + " (root mean square)"
    return f"{measured(c.last, c.spread)} {c.unit}".rstrip()


def plain_signs(text: str) -> str:
    """The same with a hyphen for minus, as terminals and programs want it."""
    return text.replace("−", "-")


def sureness(finding: Finding) -> str:
    """In how many samples it was suspected, against how many by chance, and how far it was trusted."""
    trust = "" if math.isnan(finding.trust) else f", mean trust {finding.trust:.2f}"
    told = finding.expected is not None and not finding.faint  # faint ones follow from each other
    chance = f", {rounded(finding.expected or 0.0)} by chance" if told else ""
    return f"suspected in {finding.suspected:,} of {count(finding.sent, 'sample')}{chance}{trust}"


def crowded(crowd: Crowd, clock: Clock) -> str:
    """A stretch in which too many sensors were suspected to blame them."""
    names = enumerate_names(crowd.sensors)
    where = stretch(crowd.since, crowd.until, clock)
    head = f"{where[:1].upper()}{where[1:]} {count(len(crowd.sensors), 'sensor')} contradict"
    if len(crowd.sensors) == 1:
        head += "s"
    if not crowd.persistent:
        blame = "which is a jump of the plant rather than a lie of them all"
    elif crowd.since.index < START:
        blame = "the record may start far from the operating point; start with a window (--prior window)"
    else:
        blame = "too many to say who lies; check the model, or what happened to the plant"
    return f"{head} the others and the plant at once ({names}): {blame}."


def remarks(alarms: Alarms) -> Iterator[str]:
    """What there is to say about alarms that are no finding."""
    if alarms.at_start:
        names = enumerate_names(tuple(name for name, _ in alarms.at_start))
        were = "was" if len(alarms.at_start) == 1 else "were"
        if max(number for _, number in alarms.at_start) <= alarms.settled:
            where, advice = f"At the start, before sample {alarms.settled},", ""
        else:
            where, advice = "From the start on and for a while", "; a window avoids it (--prior window)"
        yield f"{where} {names} {were} suspected, as may happen while a filter settles{advice}."
    if alarms.count:
        yield _isolated(alarms)
    for name, number in alarms.frequent:
        yield f"{name} raised {number:,} of them, more than chance explains, never many together: watch it."


def _isolated(alarms: Alarms) -> str:
    """How many isolated alarms there are, against how many to expect.

    Examples:
        >>> _isolated(Alarms(12, 0.001, 14.2, (), 10, ()))
        '12 isolated alarms, about as many as the stated rate of 0.1 % leads to expect (14).'
    """
    number = count(alarms.count, "isolated alarm")
    if alarms.rate is None or alarms.expected is None:
        return f"{number}; this method states no rate of false alarms to compare with."
    many = alarms.count > alarms.expected + 3 * math.sqrt(alarms.expected) + 1
    few = alarms.count < alarms.expected - 3 * math.sqrt(alarms.expected)
    how = "more than" if many else "fewer than" if few else "about as many as"
    advice = " The model may state too little noise: see securestate judge." if many else ""
    rate = f"the stated rate of {100 * alarms.rate:g} %"
    return f"{number}, {how} {rate} leads to expect ({rounded(alarms.expected)}).{advice}"


def period(p: Period, clock: Clock) -> str:
    """When a status other than OK held, what it means, and what to do."""
    since, until = p.longest
    where = stretch(since, until, clock)
    if len(p.stretches) > 1:
        where = f"{count(len(p.stretches), 'stretch').replace('stretchs', 'stretches')}, the longest {where}"
    return f"{p.status} in {count(p.samples, 'sample')}, {where}: {p.meaning}."


def plain(value: float) -> str:
    """A positive number in three digits."""
    return f"{value:.3g}"


def rounded(number: float) -> str:
    """A small number in two digits, a larger one as a whole number."""
    return f"{number:.0f}" if number >= 10 else f"{number:.2g}"


def measured(value: float, spread: float) -> str:
    """A value with its spread, as many digits as the spread deserves.

    Examples:
        >>> measured(12.3456, 0.0321), measured(-4210.0, 130.0), measured(3e-9, 1e-10)
        ('+12.346 ± 0.032', '−4210 ± 130', '+3e-09 ± 1e-10')
    """
    size = max(abs(value), spread)
    if size and not 1e-3 <= size < 1e6:
        text = f"{value:+.3g} ± {spread:.2g}"
    else:
        last = spread if spread > 0 else size or 1.0
        digits = min(6, max(0, 1 - math.floor(math.log10(last))))
        text = f"{value:+.{digits}f} ± {spread:.{digits}f}"
    return text.replace("-", "−", 1) if text.startswith("-") else text

"""The tables of an installation's report: what would help, which estimator fits, how firm the limit is."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING

from securestate._analysis_text import form_margin, interval, names
from securestate._words import count
from securestate.reporting.comparison_tables import scroll
from securestate.reporting.page import definitions, table
from securestate.resilience import FusionMargin, Limit, Option

if TYPE_CHECKING:
    from securestate.analysis import FormMargin, Resilience

KINDS = {
    "copy": "Install more of the same",
    "measure": "Measure a state",
    "protect": "Protect",
    "add": "Add sensors",
}
"""What kinds of options are called."""

_VERDICTS = {"secure": ("yes", "secure"), "insecure": ("no", "insecure"), "undecided": ("open", "undecided")}

NAMED = 12
"""So many sensors or states of an option are named."""


@dataclass(frozen=True, eq=False)
class Improved:
    """An option and the limit after it."""

    option: Option
    limit: Limit


def facts(found: Resilience, source: str | os.PathLike[str] | None) -> str:
    """What was looked at, and how sure the answer is."""
    plant, limit = found.plant, found.limit
    channels = "" if plant.m == plant.n_sensors else f" with {plant.m} channels"
    directions = sum(mode.multiplicity for mode in limit.modes)
    kind = "(those that do not fade)" if found.lasting else "(all; every one fades)"
    settled = "exact" if limit.exact else "bounds, not settled in time"
    return definitions(
        {
            "States": f"{plant.n:,}",
            "Sensors": f"{plant.n_sensors:,}{channels}",
            "Protected": f"{int(plant.protected.sum()):,}",
            "Modes counted": f"{directions:,} {kind}",
            "Survives": survives(limit) + ("" if limit.unlimited or limit.upper == 0 else f" ({settled})"),
            "Margin η": interval(*found.eta) if found.robust_to and not limit.unlimited else "",
            "Tolerance": f"{limit.tol:g}",
            "Computed in": f"{found.seconds:.1f} s",
            "Source": "" if source is None else os.fspath(source),
        }
    )


def survives(limit: Limit) -> str:
    """A limit as a phrase."""
    if limit.upper == 0:
        return "not even honest sensors suffice"
    if limit.unlimited:
        return "any number of liars"
    low, high = max(0, limit.max_attacked), limit.max_attacked_upper
    if high == 0:
        return "no liar"
    return count(high, "liar") if low == high else f"{low} to {count(high, 'liar')}"


def options(improved: Sequence[Improved]) -> str:
    """Every option with the limit after it."""
    if not improved:
        return ""
    head = ("What to do", "Which", "How many", "Fewest of this kind?", "Survives afterwards")
    return scroll(table(head, (_option(one) for one in improved)), "What would help")


def _option(one: Improved) -> str:
    option = one.option
    return (
        f'<tr><th scope="row">{KINDS[option.kind]}</th><td class="where">{escape(items(option))}</td>'
        f"<td>{option.total:,}</td><td>{'yes, proved' if option.fewest else 'fewer may do'}</td>"
        f"<td>{survives(one.limit)}</td></tr>"
    )


def items(option: Option) -> str:
    """What an option is about, and how often."""
    told = [name if times == 1 else f"{times} × {name}" for name, times in option.items]
    more = f" and {len(told) - NAMED} more" if len(told) > NAMED else ""
    return f"{', '.join(told[:NAMED])}{more}"


def estimators(found: Resilience) -> str:
    """One row per form of sparse fusion and number of liars, and one for the methods that need protection."""
    rows = [row for form in found.forms for row in _form(form)]
    head = ("Method", "Liars", "ρ", "Verdict", "Worst sensors, or why")
    return scroll(table(head, [*rows, _joint(found)]), "Estimators")


def _form(form: FormMargin) -> Iterator[str]:
    name = f"Sparse fusion, {form.form} form"
    reason = form_margin(form).removeprefix("cannot be designed, ")
    if form.refusal:
        yield _row(name, "", "", ("no", "cannot be designed"), reason)
        return
    for margin in form.margins:
        if margin.lie is None:
            yield _row(name, str(margin.attacked), "", ("yes", "bounded"), reason)
        else:
            yield _row(
                name, str(margin.attacked), _rho(margin), _VERDICTS[margin.verdict], names(margin.sensors)
            )


def _rho(margin: FusionMargin) -> str:
    """Bounds of rho as the margin itself prints them."""
    return str(margin).rpartition("(rho ")[2].rstrip(")").replace("inf", "∞")


def _joint(found: Resilience) -> str:
    name = "Joint fusion and other methods with protected sensors"
    if not found.plant.protected.any():
        return _row(name, "", "", ("no", "cannot be used"), "no sensor is protected")
    if found.unprotected:
        hidden = names([str(mode) for mode in found.unprotected])
        why = f"the protected sensors do not see {hidden}, and the others can lie along them"
        return _row(name, "any", "", ("no", "insecure"), why)
    why = "the protected sensors see every mode that lasts, so its error stays bounded"
    return _row(name, "any", "", ("yes", "bounded"), why)


def _row(name: str, liars: str, rho: str, verdict: tuple[str, str], why: str) -> str:
    kind, word = verdict
    return (
        f'<tr><th scope="row">{escape(name)}</th><td>{liars or "–"}</td><td>{rho or "–"}</td>'
        f'<td><span class="verdict {kind}">{word}</span></td><td class="where">{escape(why)}</td></tr>'
    )


def tolerances(found: Resilience) -> str:
    """The limit by tolerance, if it is not always the same."""
    if len({(low, high) for _, low, high in found.profile}) < 2:
        return ""
    rows = (
        f'<tr><th scope="row">{tol:.0e}</th><td>{low if low == high else f"{low} to {high}"}</td></tr>'
        for tol, low, high in found.profile
    )
    return (
        "<section><h2>How firm the limit is</h2>"
        '<p class="hint">Eigenvalues and sensitivities that differ by less than the tolerance count as equal '
        "and as zero. A limit that falls as the tolerance grows rests on the last digits of the model: "
        "believe the row that has the accuracy of yours.</p>"
        f"{scroll(table(('Tolerance', 'Survives'), rows), 'Limit by tolerance')}</section>"
    )

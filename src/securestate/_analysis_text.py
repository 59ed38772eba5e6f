"""A `Resilience` as a page of text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np

from securestate._words import NAMED, count
from securestate.resilience.limit import ROBUST, Limit, ModeLimit

if TYPE_CHECKING:
    from securestate.analysis import FormMargin, Resilience

WIDTH = 110
#: A margin that noise hides.
FAINT = 0.01


def text(found: Resilience) -> str:
    """The page."""
    sections = [[headline(found), *remarks(found)], list(_advice(found)), list(_estimators(found))]
    return "\n\n".join("\n".join(_wrapped(lines)) for lines in sections if lines)


def headline(found: Resilience) -> str:
    """One sentence: what the installation survives."""
    return f"{found.plant.name or 'This plant'} {survives(found.limit)}."


def survives(limit: Limit) -> str:
    """What a plant survives, as a phrase that begins with a verb."""
    if limit.upper == 0:
        return f"cannot be secured: {_weak(limit)} is seen by no sensor"
    if limit.unlimited:
        why = "the protected ones see every mode" if limit.modes else "nothing that lasts has to be seen"
        return f"survives any number of lying sensors: {why}"
    if not limit.exact:
        between = f"{limit.max_attacked} to {limit.max_attacked_upper}"
        return f"survives {between} lying sensors (not settled in time)"
    if limit.max_attacked == 0:
        return "survives no lying sensor"
    return f"survives {count(limit.max_attacked, 'lying sensor')}, whichever {_they(limit.max_attacked)}"


def _they(number: int) -> str:
    return "it is" if number == 1 else "they are"


def _weak(limit: Limit) -> str:
    return "" if limit.weakest is None else str(limit.weakest.mode)


def remarks(found: Resilience) -> Iterator[str]:
    """What to know about the limit: which modes count, where it is weakest, how firm it is."""
    limit, plant = found.limit, found.plant
    if not found.lasting and limit.modes:
        largest = float(np.abs(np.linalg.eigvals(plant.A)).max())
        yield (
            f"Every mode fades (largest |eigenvalue| {largest:.4g}), so the error stays bounded even without "
            "sensors; the limit is for telling the state from a lie while it lasts."
        )
    elif found.all_modes is not limit and found.all_modes.max_attacked != limit.max_attacked:
        every = found.all_modes.max_attacked
        said = str(every) if every >= 0 else "none, because no sensor sees some of them"
        yield f"With the modes that fade counted as well: {said}."
    if limit.weakest is not None and limit.upper > 0:
        yield weakest(limit.weakest)
    if found.robust_to and limit.modes and not limit.unlimited:
        left = interval(*found.eta)
        faint = ", which noise can hide for long" if found.eta[1] < FAINT else ""
        without = f"Margin: without the worst {found.robust_to} sensors"
        yield f"{without}, {left} of every motion is still seen{faint}."
        if found.robust < limit.max_attacked:
            yield f"A share of {ROBUST:g} or more is left up to {count(found.robust, 'lying sensor')}."
    levels = {(low, high) for _, low, high in found.profile}
    if len(levels) > 1:
        told = ", ".join(
            f"{low}{'' if low == high else f' to {high}'} at {tol:.0e}" for tol, low, high in found.profile
        )
        yield f"The limit rests on the digits of the model; by tolerance: {told}."


def weakest(mode: ModeLimit) -> str:
    """Where the installation is weakest."""
    number = len(mode.sensors)
    bound = "" if mode.exact else f" (no fewer than {mode.lower:.0f} see any direction)"
    half = (number + 1) // 2
    lost = (
        f"when {half} of them lie together, nobody can tell who does"
        if number > 2
        else "when one of them lies, nobody can tell which"
        if number == 2
        else "when it lies, nobody can tell"
    )
    return f"Weakest: {mode.mode}, seen by {count(number, 'sensor')}, {names(mode.sensors)}{bound}: {lost}."


def _advice(found: Resilience) -> Iterator[str]:
    if found.options:
        goal = "To see every mode" if found.goal == 0 else f"To survive {count(found.goal, 'lying sensor')}"
        yield f"{goal}:"
        yield from (
            f"  - {option.told(NAMED)}{'' if option.fewest else ' (fewer may do)'}"
            for option in found.options
        )
    elif not found.limit.unlimited and found.max_attacked < found.goal:
        yield f"No change of few sensors was found that survives {found.goal}."
    if found.protection is not None and found.protection[0] and not found.limit.unlimited:
        chosen, fewest = found.protection
        many = f"{count(len(chosen), 'sensor')}{'' if fewest else ' (fewer may do)'}"
        yield f"To survive any number: protect {many}: {names(chosen)}."


def _estimators(found: Resilience) -> Iterator[str]:
    for form in found.forms:
        yield f"Sparse fusion, {form.form} form: {form_margin(form)}."
    plant = found.plant
    if not plant.protected.any():
        yield "Joint fusion and the other methods with protected sensors: none is protected."
    elif found.unprotected:
        hidden = names([str(mode) for mode in found.unprotected])
        yield f"Joint fusion: the protected sensors do not see {hidden}, and the others can lie along them."
    else:
        yield "Joint fusion: the protected sensors see every mode that lasts, so its error stays bounded."
    yield f"Use {found.method}: {found.why}." if found.method else f"Use none of them yet: {found.why}."


def form_margin(form: FormMargin) -> str:
    """What a form of sparse fusion survives, as a phrase."""
    if form.refusal:
        return f"cannot be designed, {form.refusal}"
    if all(margin.lie is None for margin in form.margins):
        return "no lie moves it without bound"
    told = []
    for margin in form.margins:
        worst = "" if margin.verdict == "secure" else f", worst {names(margin.sensors)}"
        told.append(f"{margin}{worst}")
    return "; ".join(told)


def interval(low: float, high: float) -> str:
    """A number, or its bounds."""
    return f"{low:.3g}" if high - low <= 1e-6 else f"{low:.3g} to {high:.3g}"


def names(chosen: Sequence[str]) -> str:
    """A list of names, cut where it is long."""
    if len(chosen) <= NAMED:
        return ", ".join(chosen)
    return f"{', '.join(chosen[:NAMED])} and {len(chosen) - NAMED} more"


def _wrapped(lines: Sequence[str]) -> Iterator[str]:
    for line in lines:
        indent = "    " if line.startswith("  -") else "  "
        yield fill(line, WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)

"""Who takes part in `benches.secure_filter`: the oracle, all methods, variants of some."""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping
from functools import partial

from benches._secure_cells import FAMILY, Cell
from benches._secure_limit import WAYS
from securestate import (
    Estimator,
    InnovationMixture,
    JointFusion,
    MixtureFusion,
    OracleFilter,
    Plant,
    SecureFilter,
)
from securestate.estimators.registry import METHODS
from securestate.estimators.secure_filter import kernel

Design = Callable[[Plant], Estimator | OracleFilter]

ORACLE = "oracle"
#: The method that the others are held against.
JUDGED = "secure"
#: What no method can be held against, because it is told what they are not.
TOLD = frozenset({ORACLE, *WAYS})
#: Their design takes longer than all that the others do. Where every run has its own plant they get this
#: share of the runs, and at least so many.
SLOW, SHARE, LEAST = frozenset({"bias-monitor"}), 0.25, 5

#: Settings that are sensible for some plants and not the default.
_VARIANTS: Mapping[str, Design] = {
    "innovation-mixture sticky": partial(InnovationMixture, memory="sticky"),
    "innovation-mixture monitor": partial(InnovationMixture, monitor=0.95),
    "joint adaptive": partial(JointFusion, eta="adaptive"),
    "mixture repaired": partial(
        MixtureFusion, epsilon="none", init="median", mean="precision", floor="prior", feedback=True
    ),
}


#: Parts of SecureFilter that can be left out: "secure without reuse".
PARTS = ("habits", "steady", "reuse", "regression", "doubt", "votes")


def _ablated(plant: Plant, part: str) -> Estimator:
    """SecureFilter without a part."""
    estimator = SecureFilter(plant)
    rate = float(str(estimator.settings["false_alarm_rate"]))
    estimator.kernel = kernel(plant, estimator.steady, rate, [part])
    return estimator


def methods() -> dict[str, Design]:
    """All of them by name, the oracle first and the one that is judged second."""
    known: dict[str, Design] = {name: method.design for name, method in METHODS.items()} | dict(_VARIANTS)
    return {ORACLE: OracleFilter, JUDGED: known[JUDGED]} | known


def variant(name: str) -> Design | None:
    """The method of this name, settings after a colon as in "gate:false_alarm_rate=.1"; None: there is none.

    SecureFilter without one of its `PARTS` is "secure without reuse" and the like.

    Several settings have a semicolon between them; a value is a literal of Python, or else a word.
    """
    base, _, settings = name.partition(":")
    word, _, part = base.partition(" without ")
    if word == JUDGED and part in PARTS:
        return partial(_ablated, part=part)
    design = methods().get(base)
    if design is None or not settings:
        return design
    pairs = (setting.partition("=") for setting in settings.split(";"))
    return partial(design, **{key: _literal(value) for key, _, value in pairs})


def _literal(text: str) -> object:
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError):
        return text


def runs_of(method: str, cell: Cell, runs: int) -> int:
    """How many of the runs a method gets."""
    few = method in SLOW and cell.plant in FAMILY
    return min(runs, max(LEAST, round(SHARE * runs))) if few else runs

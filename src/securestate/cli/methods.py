"""The registered methods as the command line offers them: chosen by name, ready to start."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Mapping

from securestate._words import enumerate_names
from securestate.errors import DesignError, InputError, SecurestateWarning
from securestate.estimators import AUTO, DEFAULT, METHODS, Estimator
from securestate.plant import Plant

#: Methods to name where AUTO cannot be used, the most capable first.
INSTEAD = ("sparse", "adaptive-joint", "gate", "kalman")


def design(plant: Plant, name: str, choices: Mapping[str, object], *, given: bool = False) -> Estimator:
    """Design an estimator; `choices` are the settings that were given, `given` says that a prior will be.

    Raises:
        DesignError: the plant does not allow the method, or it could not start without a prior; the advice
            for AUTO names methods that the plant allows. No other method is taken in silence.
        InputError: a setting is out of range.
    """
    if name != AUTO:
        return _design(plant, name, choices, given=given)
    try:
        return _design(plant, DEFAULT, choices, given=given)
    except DesignError as refusal:
        reason = f"--method {AUTO} stands for {DEFAULT}, which cannot be used here: {refusal.reason}"
        raise DesignError(reason, _instead(plant, refusal.advice, given=given)) from None


def _design(plant: Plant, name: str, choices: Mapping[str, object], *, given: bool) -> Estimator:
    estimator = METHODS[name].design(plant, **choices)
    if estimator.no_steady_state and not given:
        reason = f"{estimator.name} has no steady state to start from: {estimator.no_steady_state}"
        advice = (
            "start from the first samples, --prior window, "
            f"or from Python with a prior: {estimator.name}(plant).run(y, u, prior)"
        )
        raise DesignError(reason, advice)
    return estimator


def _instead(plant: Plant, advice: str, *, given: bool) -> str:
    """The advice of the method itself, and which of the usual others the plant allows."""
    allowed = []
    for name in INSTEAD:
        with warnings.catch_warnings(), contextlib.suppress(DesignError):
            warnings.simplefilter("ignore", SecurestateWarning)
            _design(plant, name, {}, given=given)
            allowed.append(f"--method {name} ({METHODS[name].summary})")
    others = enumerate_names(allowed) if allowed else ""
    return "; ".join(filter(None, [advice, others and f"or use {others}"]))


def refuse_foreign(name: str, choices: Mapping[str, object]) -> None:
    """Refuse settings that belong to other methods than `name`.

    Raises:
        InputError: names the option and the methods that know it.
    """
    meant = DEFAULT if name == AUTO else name
    for setting in choices:
        if setting not in METHODS[meant].settings:
            owners = [other for other, method in METHODS.items() if setting in method.settings]
            expected = f"--method {' or '.join(filter(None, [', '.join(owners[:-1]), owners[-1]]))}"
            stands = f", which stands for {DEFAULT}" if name == AUTO else ""
            raise InputError(f"--{setting}".replace("_", "-"), expected, f"--method {name}{stands}")

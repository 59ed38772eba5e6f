"""The registered methods as the command line offers them: chosen by name, ready to start."""

from __future__ import annotations

from collections.abc import Mapping

from securestate.errors import DesignError, InputError
from securestate.estimators import METHODS, Estimator
from securestate.plant import Plant


def design(plant: Plant, name: str, choices: Mapping[str, object], *, given: bool = False) -> Estimator:
    """Design an estimator; `choices` are the settings that were given, `given` says that a prior will be.

    Raises:
        DesignError: the plant does not allow the method, or it could not start without a prior.
        InputError: a setting is out of range.
    """
    estimator = METHODS[name].design(plant, **choices)
    if estimator.no_steady_state and not given:
        reason = f"{estimator.name} has no steady state to start from: {estimator.no_steady_state}"
        advice = (
            "start from the first samples, --prior window, "
            f"or from Python with a prior: {estimator.name}(plant).run(y, u, prior)"
        )
        raise DesignError(reason, advice)
    return estimator


def refuse_foreign(name: str, choices: Mapping[str, object]) -> None:
    """Refuse settings that belong to other methods than `name`.

    Raises:
        InputError: names the option and the methods that know it.
    """
    for setting in choices:
        if setting not in METHODS[name].settings:
            owners = [other for other, method in METHODS.items() if setting in method.settings]
            expected = f"--method {' or '.join(filter(None, [', '.join(owners[:-1]), owners[-1]]))}"
            raise InputError(f"--{setting}".replace("_", "-"), expected, f"--method {name}")

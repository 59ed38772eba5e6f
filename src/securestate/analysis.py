"""How many liars an installation survives, with which estimator, and what to change; before any data.

`securestate.resilience` answers for the plant alone; here the estimators' own conditions are put beside it.
"""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass
from typing import Literal, final

import numpy as np

from securestate._checks import whole_number
from securestate.errors import DesignError, InputError, InsecureWarning
from securestate.estimators.sparse_fusion import SparseFusion
from securestate.plant import Plant
from securestate.resilience.advice import Option, options, smallest_protection
from securestate.resilience.detectability import Mode, modes, undetectable_modes
from securestate.resilience.eigenspaces import TOLERANCE
from securestate.resilience.fusion_margin import FusionMargin
from securestate.resilience.limit import Limit, limit, profile, relevant
from securestate.resilience.margin import SLOW
from securestate.resilience.visibility import Visibility, visibility

#: Numbers in A and C up to which the limit is computed for other tolerances as well.
PROFILED = 20_000
#: n m up to which the paper form of sparse fusion is looked at.
JORDAN = 1000
#: n m above which sparse fusion is not designed if every mode has a prior and nothing depends on it.
LARGE = 1500


@final
@dataclass(frozen=True, eq=False)
class FormMargin:
    """What one form of an estimator survives.

    Attributes:
        form: of sparse fusion.
        margins: for one liar, two and so on up to the first number that is not secure, or that was asked
            about.
        refusal: why the form cannot be designed for this plant; empty if it can.
    """

    form: str
    margins: tuple[FusionMargin, ...]
    refusal: str = ""


@final
@dataclass(frozen=True, eq=False)
class Resilience:
    """What an installation survives, and what would make it survive more. Printed, it is a page of text.

    Attributes:
        plant: the plant.
        attacked: the number of liars that margins and advice are about.
        limit: over the modes that do not fade, or over all modes if every mode fades.
        all_modes: over all modes; the same object where `limit` is about all of them.
        undetectable: modes that do not fade and that no sensor sees.
        eta: bounds of the least share of a motion that is left when the worst 2 p sensors are taken away, p
            the limit; `robust_to` is that 2 p.
        robust: most liars p for which eta of the worst 2 p sensors is certainly 0.1 or more.
        profile: (tolerance, lowest, highest limit): one that falls with the tolerance rests on the model's
            digits.
        view: modes by sensors.
        forms: the forms of sparse fusion.
        unprotected: modes that do not fade and that the protected sensors do not see; all of them if there
            are none.
        protection: the smallest set to protect so that all others may lie, and whether no smaller one does;
            None if not even all sensors see every mode.
        options: ways to survive `attacked` liars, or one more than now.
        goal: the number of liars that `options` are about.
        method, why: the method to use, by its name on the command line, and the reason.
        seconds: that the analysis took.
    """

    plant: Plant
    attacked: int
    limit: Limit
    all_modes: Limit
    undetectable: tuple[Mode, ...]
    eta: tuple[float, float]
    robust: int
    profile: tuple[tuple[float, int, int], ...]
    view: Visibility
    forms: tuple[FormMargin, ...]
    unprotected: tuple[Mode, ...]
    protection: tuple[tuple[str, ...], bool] | None
    options: tuple[Option, ...]
    goal: int
    method: str
    why: str
    seconds: float

    @property
    def max_attacked(self) -> int:
        """Liars that some estimator survives for certain; -1 if not even honest sensors see everything."""
        return self.limit.max_attacked

    @property
    def robust_to(self) -> int:
        """2 p, the number of sensors that `eta` takes away."""
        return 2 * max(0, self.max_attacked)

    @property
    def verified(self) -> bool:
        """Whether `eta` proves the limit without counting: something is left of every motion."""
        return self.eta[0] > 0

    @property
    def lasting(self) -> bool:
        """Whether some mode does not fade, so that `limit` is about errors that can grow or stay."""
        return bool(self.limit.modes) and self.limit.cut == SLOW

    def __str__(self) -> str:
        from securestate._analysis_text import text  # it reads what is here

        return text(self)


def analyse(
    plant: Plant, attacked: int | None = None, *, tol: float = TOLERANCE, time_limit: float = 60.0
) -> Resilience:
    """Find how many liars a plant survives, where it is weak, which estimator fits, and what would help.

    Args:
        plant: time-invariant.
        attacked: the number of liars to plan for, >= 1. Default: as many as the plant survives now, at least
            one; advice is then about one more.
        tol: eigenvalues this close, relative to ||A||, and sensitivities this small count as equal and as
            zero; take the accuracy of the model: 1e-8 for one that is written down, 1e-4 to 1e-3 for one that
            was identified.
        time_limit: seconds, about; what is not settled by then is given as bounds or left out.

    Raises:
        DesignError: the plant varies in time.
        InputError: attacked is no whole number >= 1, or tol or time_limit is out of range.

    References:
        Shoukry, Tabuada 2016 (sparse detectability); Liu, Mo, Garone 2020, Theorem 4 (margins of sparse
        fusion).

    Examples:
        >>> from securestate import Plant, Sensor, analyse
        >>> sensors = [Sensor(name, C=[1, 0], R=1) for name in "abc"] + [Sensor("d", C=[1, 1], R=1)]
        >>> resilience = analyse(Plant([[1, 0], [0, 1]], [[1, 0], [0, 1]], sensors))
        >>> resilience.max_attacked, str(resilience.options[0])
        (0, 'protect d')
    """
    if not isinstance(plant, Plant):
        raise InputError("plant", "a Plant; Plant.load reads a file", type(plant).__name__)
    if attacked is not None:
        whole_number("attacked", attacked, 1, InputError)
        if attacked > max(1, free := int((~plant.protected).sum())):
            raise InputError("attacked", f"at most the {free} sensors that are not protected", str(attacked))
    begin = time.monotonic()
    found = relevant(plant, tol=tol, time_limit=0.2 * time_limit)
    every = found if found.cut == 0 else limit(plant, 0.0, tol=tol, time_limit=0.1 * time_limit)
    planned = attacked or max(1, found.max_attacked)
    goal = attacked or found.max_attacked + 1
    forms = tuple(
        _form(plant, form, planned, bool(found.cut == SLOW), 0.05 * time_limit)
        for form in ("robust", "paper")
    )
    guards = np.flatnonzero(plant.protected).tolist()
    hidden = undetectable_modes(plant.select(guards), SLOW) if guards else modes(plant, SLOW)
    method, why = _recommended(plant, found, forms, hidden)
    ways = options(found, goal, 0.3 * time_limit)
    return Resilience(
        plant=plant,
        attacked=planned,
        limit=found,
        all_modes=every,
        undetectable=undetectable_modes(plant, SLOW),
        eta=found.margin(2 * max(0, found.max_attacked), time_limit=0.1 * time_limit),
        robust=found.robust(time_limit=0.1 * time_limit),
        profile=_profile(plant, found, 0.1 * time_limit),
        view=visibility(found),
        forms=forms,
        unprotected=hidden,
        protection=_protection(found, ways, 0.1 * time_limit),
        options=ways,
        goal=goal,
        method=method,
        why=why,
        seconds=time.monotonic() - begin,
    )


def _form(
    plant: Plant, form: Literal["robust", "paper"], attacked: int, lasting: bool, time_limit: float
) -> FormMargin:
    if form == "paper" and plant.n * plant.m > JORDAN:
        return FormMargin(form, (), f"with n m above {JORDAN} its Jordan basis is beyond double precision")
    try:
        if form == "robust" and not lasting and plant.n * plant.m > LARGE:  # bounded whoever lies
            SparseFusion.require(plant)
            return FormMargin(form, (FusionMargin(attacked, 0.0, 0.0, (), None),))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", InsecureWarning)  # that is what the margins say
            design = SparseFusion(plant) if form == "robust" else SparseFusion(plant, form="paper", gamma=1.0)
    except DesignError as refusal:
        return FormMargin(form, (), refusal.reason)
    margins: list[FusionMargin] = []
    while len(margins) < attacked and (not margins or margins[-1].verdict == "secure"):
        margins.append(design.margin(len(margins) + 1, time_limit=time_limit / attacked))
    unmoved = all(margin.lie is None for margin in margins)
    return FormMargin(form, tuple(margins[-1:] if unmoved else margins))


def _protection(
    found: Limit, ways: tuple[Option, ...], time_limit: float
) -> tuple[tuple[str, ...], bool] | None:
    """The smallest protection; of several the one that the options name as well."""
    smallest = smallest_protection(found, time_limit)
    way = next((way for way in ways if way.kind == "protect"), None)
    if way is None or smallest is None or way.total != len(smallest[0]):
        return smallest
    enough = limit(way.plant, found.cut, tol=found.tol, time_limit=time_limit).unlimited
    return (tuple(name for name, _ in way.items), smallest[1]) if enough else smallest


def _profile(plant: Plant, found: Limit, time_limit: float) -> tuple[tuple[float, int, int], ...]:
    if plant.n * (plant.n + plant.m) > PROFILED:
        return ()
    limits = profile(plant, found.cut, time_limit)
    return tuple((tol, one.max_attacked, one.max_attacked_upper) for tol, one in limits)


def _recommended(
    plant: Plant, found: Limit, forms: tuple[FormMargin, ...], hidden: tuple[Mode, ...]
) -> tuple[str, str]:
    """The method to use and why; an empty name if none can work."""
    if found.upper == 0:
        return "", "no estimator can follow a mode that no sensor sees"
    if found.max_attacked_upper == 0:
        return "", (
            "no method can tell who lies where fewer than three sensors see a mode: change the installation "
            "first; until then the Kalman filter trusts them all"
        )
    protecting = bool(plant.protected.any()) and not hidden
    if not _noise_is_shared(plant):
        return "secure", _why_secure(forms[0], protecting=protecting)
    if protecting:
        return "adaptive-joint", (
            "the protected sensors see every mode that lasts, so that whatever the others send cannot move "
            "the estimate away; they are used as long as they agree"
        )
    robust = forms[0]
    if robust.margins and robust.margins[0].verdict == "secure" and robust.margins[0].lie is not None:
        return "sparse", (
            f"with rho {robust.margins[0].upper:.3g} no single sensor can move it without bound, if the liar "
            "stays the same; the noise of some sensors is correlated, which secure does not allow"
        )
    return "gate", (
        "the noise of some sensors is correlated, which secure does not allow: make them one sensor with "
        "several channels, or add their common noise as a state"
    )


def _noise_is_shared(plant: Plant) -> bool:
    """Whether R correlates two sensors."""
    apart = plant.channel_sensor[:, None] != plant.channel_sensor
    return bool(np.any(apart & (plant.R != 0)))


def _why_secure(robust: FormMargin, *, protecting: bool) -> str:
    """What speaks for the secure filter, and which method promises more."""
    finds = "it finds liars that stay the same as well as those that change, and remembers them"
    if protecting:
        return (
            f"{finds}; the protected sensors, which see every mode that lasts, are always believed and judge "
            "the others, however many lie"
        )
    if robust.refusal:
        return f"{finds}; sparse fusion cannot be designed for this plant"
    if robust.margins[0].verdict != "secure":
        return f"{finds}; what it reaches is measured: no method has a guarantee on this plant"
    if robust.margins[0].lie is None:
        return f"{finds}; what it reaches is measured, not proved"
    return (
        f"{finds}; what it reaches is measured, while sparse has a guarantee: with rho "
        f"{robust.margins[0].upper:.3g} no single sensor that stays the liar can move it without bound"
    )

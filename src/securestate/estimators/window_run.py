"""Runs that begin with a cold start: its samples, then the estimator from the belief after them."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from securestate.errors import SecurestateWarning
from securestate.estimators.base import Estimator, Filter, Status
from securestate.estimators.cold_start import ColdStart, cold_start
from securestate.estimators.run import Run
from securestate.plant import Belief

Float = NDArray[np.float64]


def run_from_window(estimator: Estimator, y: Float, u: Float, *, covariance: bool) -> Run:
    """Run without a prior: y (T, m) or (runs, T, m), u (T, p) or (runs, T, p), checked; runs one by one.

    Warns once if some window is not certified.
    """
    if y.ndim == 2:
        run, first = _one(estimator, y, u, covariance)
        _warn([first])
        return run
    shared = u.ndim == 2
    pairs = [_one(estimator, y[i], u if shared else u[i], covariance) for i in range(len(y))]
    _warn([first for _, first in pairs])
    return _stack([run for run, _ in pairs])


def _one(estimator: Estimator, y: Float, u: Float, covariance: bool) -> tuple[Run, ColdStart]:
    inputs = u if estimator.plant.n_inputs else None
    first = cold_start(estimator.plant, y, inputs)
    blocks, tau = [window_run(estimator, first, covariance=covariance)], first.samples
    if tau < len(y):
        rest = None if inputs is None else inputs[tau:]
        blocks.append(start_after(estimator, first).run(y[tau:], rest, covariance=covariance))
    return Run.concat(blocks), first


def start_after(estimator: Estimator, first: ColdStart) -> Filter:
    """A live filter whose first measurement is the one after the window."""
    x, P = first.belief.x, first.belief.P
    belief = Belief(x, P if estimator.takes_covariance else None)
    return estimator.from_sample(first.samples).start(belief)


def window_run(estimator: Estimator, first: ColdStart, *, covariance: bool) -> Run:
    """The samples of the window as a run of the estimator.

    Innovations and diagnostics are NaN: without a prior there is no prediction.
    """
    tau, unknown = first.samples, np.full_like(first.attack, np.nan)
    status = Status.COLD_START if first.certified else Status.ILL_CONDITIONED
    return Run(
        plant=estimator.plant,
        estimator=estimator.name,
        settings=estimator.settings,
        x=first.x,
        x_std=np.sqrt(np.maximum(np.diagonal(first.P, axis1=1, axis2=2), 0.0)),
        P=first.P if covariance else None,
        trust=first.trust,
        attack=first.attack,
        attack_std=first.attack_std,
        suspected=first.suspected,
        innovation=unknown,
        innovation_std=unknown,
        status=np.full(tau, status, dtype=np.uint8),
        diagnostics={name: np.full(tau, np.nan) for name in estimator.kernel.diagnostics},
    )


def _warn(firsts: Sequence[ColdStart]) -> None:
    doubtful = [first for first in firsts if not first.certified]
    if doubtful:
        of = "" if len(firsts) == 1 else f" of {len(doubtful)} of {len(firsts)} runs"
        warnings.warn(
            f"the cold start{of} is not certified: {doubtful[0].reason}; give a prior if you can",
            SecurestateWarning,
            stacklevel=4,
        )


def _stack(runs: Sequence[Run]) -> Run:
    """Runs of the same length as a batch."""
    first = runs[0]

    def stack(name: str) -> NDArray[Any]:
        return np.stack([getattr(run, name) for run in runs])

    names = (
        "x",
        "x_std",
        "trust",
        "attack",
        "attack_std",
        "suspected",
        "innovation",
        "innovation_std",
        "status",
    )
    arrays: dict[str, Any] = {name: stack(name) for name in names}
    diagnostics = {name: np.stack([run.diagnostics[name] for run in runs]) for name in first.diagnostics}
    return replace(first, **arrays, P=None if first.P is None else stack("P"), diagnostics=diagnostics)

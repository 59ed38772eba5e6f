"""How many states: what predicts samples best that were not used for fitting.

Orders are shortlisted by the innovations forms, which cost nothing more than the subspace. Independent noises
often need more states for the same law, so from there on models with independent noises are fitted, for
larger and larger orders as long as that helps. Among orders that the samples kept back cannot tell from the
best, an information criterion on the samples fitted decides.

References:
    akaike1974.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from numpy.typing import NDArray

from securestate.identification.forms import (
    Independent,
    Innovations,
    Predictor,
    Record,
    Segment,
    Stack,
    innovations_of,
    log_density,
)
from securestate.identification.independent import independent_of
from securestate.identification.maximise import Freedom, maximise
from securestate.identification.subspace import Subspace

Array = NDArray[np.float64]

#: Samples per block whose means are compared: within a block they depend on each other; of few samples fewer.
BLOCK, LEAST_BLOCK = 25, 5

#: What a parameter costs, in nats: 1 is Akaike's criterion, log(N) / 2 Schwarz's. Of plants that are not
#: exactly linear Akaike's takes too many, and parameters too many raise false alarms.
PRICE = 2.0

#: Nats per sample and channel that independent noises may lose before that matters.
COSTLY = 0.01

#: Steps up from the shortlisted orders, and how many in a row may fail to help.
CLIMB, PATIENCE = (1, 1, 1, 2, 2, 3, 3, 4, 4), 2

#: EM and L-BFGS steps of a trial fit, and samples that are enough for it: it chooses an order, no more.
TRIAL, ENOUGH = (5, 40), 20_000


@final
@dataclass(frozen=True, eq=False)
class OrderSearch:
    """The orders tried, and how well each predicts the samples kept back.

    Attributes:
        order: the one chosen.
        past: samples of the past that the regressions use.
        innovations: mean log-likelihood per sample (nats) kept back, by order, of innovations forms.
        independent: the same of models with independent noises.
        cost: nats per sample that independent noises lose against the best innovations form; may be negative.
    """

    order: int
    past: int
    innovations: Mapping[int, float]
    independent: Mapping[int, float]
    cost: float


@final
@dataclass(frozen=True, eq=False)
class Trial:
    """A model of some order.

    Attributes:
        model: fitted to samples that are not kept back.
        kept: log-likelihood of every sample kept back, nats.
        criterion: that of the samples fitted, less the price of its parameters, nats.
    """

    model: Independent | Innovations
    kept: Array
    criterion: float


def search(
    subspaces: Sequence[Subspace],
    fitted: Record,
    kept_back: Record,
    floor: Array,
    order: int | None,
    largest: int,
    tell: Callable[[str], None],
) -> tuple[OrderSearch, Independent, Subspace]:
    """Choose a past and an order; return them with the model of that order fitted to `fitted`.

    Args:
        subspaces: of `fitted`, one per length of the past that is tried. kept_back: the samples that judge.
        order: the order if it is not to be chosen. largest: of the innovations forms.
        tell: called with the order that is fitted next.
    """
    orders = range(1, largest + 1) if order is None else (order,)
    tried = [(_innovations(subspace, kept_back, orders), subspace) for subspace in subspaces]
    tried = [(forms, subspace) for forms, subspace in tried if forms]
    if not tried:
        raise np.linalg.LinAlgError("no model of any order")
    forms, subspace = max(tried, key=lambda pair: max(values.mean() for values in pair[0].values()))
    trials: dict[int, Trial] = {}
    fitted = _last(fitted, ENOUGH)

    def fit(n: int) -> None:
        if n not in trials and n <= subspace.largest_order:
            tell(f"order {n}")
            with contextlib.suppress(np.linalg.LinAlgError):  # a smaller order may do
                trials[n] = _trial(subspace, n, fitted, kept_back, floor)

    best = max(forms, key=lambda n: forms[n].mean())
    if order is not None:
        fit(order)
        chosen = order
    else:
        fit(_chosen({n: _weighed(subspace, n, values, fitted) for n, values in forms.items()}))
        fit(best)
        if not trials:
            raise np.linalg.LinAlgError("no model of any order")
        _climb(trials, fit, float(forms[best].mean()) - COSTLY * subspace.m, best + subspace.m)
        chosen = _chosen(trials)
    if chosen not in trials:
        raise np.linalg.LinAlgError(f"no model of order {chosen}")
    found = OrderSearch(
        order=chosen,
        past=subspace.p,
        innovations={n: float(values.mean()) for n, values in forms.items()},
        independent={n: float(trial.kept.mean()) for n, trial in sorted(trials.items())},
        cost=float(forms[best].mean()) - max(float(trial.kept.mean()) for trial in trials.values()),
    )
    model = trials[chosen].model
    assert isinstance(model, Independent)
    return found, model, subspace


def _last(record: Record, samples: int) -> Record:
    """The last so many samples of a record."""
    found: list[Segment] = []
    for y, u in reversed(record):
        if samples <= 0:
            break
        found.append((y[-samples:], u[-samples:]))
        samples -= len(y)
    return found[::-1]


def _innovations(subspace: Subspace, kept_back: Record, orders: range | tuple[int, ...]) -> dict[int, Array]:
    """Log-likelihood of every sample kept back, by order; orders without a model are left out."""
    found = {}
    for n in orders:
        if n > subspace.largest_order:
            break
        try:
            values = score(subspace.model(n), kept_back)
        except (np.linalg.LinAlgError, ValueError):
            continue
        if np.all(np.isfinite(values)):
            found[n] = values
    return found


def score(model: Innovations | Independent, record: Record) -> Array:
    """Log p(y[k] | the past) of every sample, nats, but for the first of each segment."""
    form = innovations_of(model) if isinstance(model, Independent) else model
    predict = Predictor(form)
    stack = Stack(record)
    density = stack.parts(log_density(predict(stack)[0], form.S))
    return np.concatenate([part[min(5, len(part) // 4) :] for part in density])


def _trial(subspace: Subspace, n: int, fitted: Record, kept_back: Record, floor: Array) -> Trial:
    """The model of order n with independent noises, as far as fitting it helps on what is kept back."""
    start = independent_of(subspace.model(n))
    freedom = replace(Freedom.all(start, subspace.feedthrough), limit=subspace.edge)
    em, steps = TRIAL
    models = (start, maximise(start, fitted, freedom, floor, em=em, steps=steps).model)
    kept, model = max(((score(each, kept_back), each) for each in models), key=lambda pair: pair[0].mean())
    return Trial(model, kept, _criterion(model, fitted, subspace.feedthrough))


def _weighed(subspace: Subspace, n: int, kept: Array, fitted: Record) -> Trial:
    """The innovations form of order n, with what the criterion says of it."""
    model = subspace.model(n)
    return Trial(model, kept, _criterion(model, fitted, subspace.feedthrough))


def _criterion(model: Independent | Innovations, fitted: Record, feedthrough: bool) -> float:
    """Log-likelihood of the samples fitted, less the price of the parameters."""
    return float(score(model, fitted).sum()) - PRICE * model.parameters(feedthrough)


def _climb(trials: Mapping[int, Trial], fit: Callable[[int], None], enough: float, reach: int) -> None:
    """Fit larger orders until that has not helped for a while.

    While the likelihood is below `enough`, what an innovations form has, orders up to `reach` are fitted:
    noises that sensors share are states of their own if every sensor has an independent noise.
    """
    n, failed = max(trials), 0
    for step in CLIMB:
        n += step
        best = max(trial.kept.mean() for trial in trials.values())
        fit(n)
        if n not in trials:
            return
        failed = failed + 1 if trials[n].kept.mean() <= best else 0
        if failed >= PATIENCE and (best >= enough or n >= reach):
            return


def _chosen(trials: Mapping[int, Trial]) -> int:
    """Of the orders that the samples kept back cannot tell from the best, the one with the best criterion.

    They cannot if the mean loss is within one standard error. The criterion uses the samples fitted, which
    are more; what is kept back guards it against a record that is not what the model supposes.
    """
    best = max(trials, key=lambda n: trials[n].kept.mean())

    def close(n: int) -> bool:
        lost = trials[best].kept - trials[n].kept
        length = max(LEAST_BLOCK, min(BLOCK, len(lost) // 8))
        blocks = lost[: len(lost) // length * length].reshape(-1, length).mean(axis=1)
        error = float(blocks.std() / np.sqrt(len(blocks))) if len(blocks) > 1 else 0.0
        return bool(lost.mean() <= error + 1e-12)

    return max((n for n in trials if close(n)), key=lambda n: trials[n].criterion + trials[n].kept.sum())

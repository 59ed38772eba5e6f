"""Spread the work of a comparison over threads or a cluster, keep what is done, go on where it stopped."""

from __future__ import annotations

import logging
import os
import signal
import threading
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from typing import Any

from securestate._checks import whole_number
from securestate.errors import InputError, SecurestateWarning
from securestate.simulation._identity import code_key, digest
from securestate.simulation._store import Kept, Store
from securestate.simulation._work import GROUP, Done, Task, groups_of, work
from securestate.simulation.scenario import Recipe, Scenario

#: Groups of a task at most, so that the last tasks do not take long while other workers wait.
BUNDLE = 10
#: Tasks waiting per worker, so that none is idle while results are kept.
AHEAD = 2
#: How often a task is done again when its worker dies, in a cluster that we start.
TRIES = 20
#: How long a scheduler may take to answer.
PATIENCE = "10s"

Progress = Callable[[int, int], None]
Outcome = tuple[list[Done], tuple[int, ...]]


def cell_key(scenario: Scenario, recipe: Recipe) -> str:
    """What identifies the results of a recipe in a scenario."""
    return digest(code_key(), scenario.key, recipe.key)


def runs_in(scenario: Scenario, group: int) -> int:
    """Number of runs of a group."""
    return min(GROUP, scenario.runs - group * GROUP)


def finish(
    scenarios: Sequence[Scenario],
    recipes: Sequence[Recipe],
    store: Store,
    *,
    workers: int | None = None,
    dask: str | None = None,
    progress: Progress | None = None,
) -> None:
    """Compute what the store lacks. The numbers do not depend on who computes them, nor in which order.

    Args:
        workers: threads, or processes of a local cluster; None: one per core.
        dask: address of a dask scheduler, or "local" for a cluster of processes on this machine.
        progress: called with the number of groups done and of all groups.

    Raises:
        InputError: `workers` or `dask` is wrong, or the cluster broke down.
    """
    width = os.cpu_count() or 1 if workers is None else workers
    whole_number("workers", width, 1, InputError)
    tasks = deque(_missing(scenarios, recipes, store))
    total = len({piece for s in scenarios for r in recipes for piece in _pieces(s, r)})
    done = total - sum(len(task.recipes) * len(task.groups) for task in tasks)
    tell = progress or (lambda *_: None)
    tell(done, total)
    running: dict[Future[Outcome], Task] = {}
    try:
        with warnings.catch_warnings(), _executor(width, dask) if tasks else nullcontext(None) as pool:
            warnings.simplefilter("ignore", SecurestateWarning)  # the table says how an estimator fared
            while pool and (tasks or running):
                while tasks and len(running) < AHEAD * pool.width:
                    task = tasks.popleft()
                    running[pool.executor.submit(work, task, alone=dask is not None)] = task
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    task, (results, left) = running[future], future.result()
                    store.put(_kept(task.scenario, result) for result in results)
                    del running[future]
                    done += len(results)
                    if left:
                        tasks.appendleft(Task(task.scenario, task.recipes, left, task.code))
                tell(done, total)
    finally:  # stopped in the middle: what the others have finished meanwhile is kept as well
        for future, task in running.items():
            if future.done() and not future.cancelled() and future.exception() is None:
                store.put(_kept(task.scenario, result) for result in future.result()[0])


def _pieces(scenario: Scenario, recipe: Recipe) -> list[tuple[str, int, int]]:
    """Cell, group and its number of runs, for all groups of a recipe in a scenario."""
    cell = cell_key(scenario, recipe)
    return [(cell, group, runs_in(scenario, group)) for group in groups_of(scenario)]


def _missing(scenarios: Sequence[Scenario], recipes: Sequence[Recipe], store: Store) -> Iterator[Task]:
    """Tasks for everything that is not kept yet; estimators that lack the same groups share simulations.

    What two scenarios or two estimators have in common, whatever their names, is done once.
    """
    planned: set[tuple[str, int, int]] = set()
    for scenario in scenarios:
        lacking: dict[tuple[int, ...], list[Recipe]] = {}
        for recipe in recipes:
            planned |= {(k.cell, k.group, k.runs) for k in store.get(cell_key(scenario, recipe))}
            pieces = _pieces(scenario, recipe)
            groups = tuple(piece[1] for piece in pieces if piece not in planned)
            planned.update(pieces)
            if groups:
                lacking.setdefault(groups, []).append(recipe)
        for groups, chosen in lacking.items():
            for start in range(0, len(groups), BUNDLE):
                yield Task(scenario, tuple(chosen), groups[start : start + BUNDLE], code_key())


def _kept(scenario: Scenario, result: Done) -> Kept:
    cell = digest(code_key(), scenario.key, result.recipe)
    runs = runs_in(scenario, result.group)
    return Kept(cell, result.group, runs, result.scores, result.refusal, result.microseconds)


@dataclass(frozen=True)
class _Pool:
    """Who does the work, and how many tasks at once."""

    executor: Executor
    width: int


@contextmanager
def _executor(width: int, dask: str | None) -> Iterator[_Pool]:
    """Threads of this process, or a cluster."""
    if dask is not None:
        with _cluster(dask, width) as pool:
            yield pool
        return
    threads = ThreadPoolExecutor(width, thread_name_prefix="securestate")
    try:
        yield _Pool(threads, width)
    finally:
        threads.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _cluster(dask: str, width: int) -> Iterator[_Pool]:
    """A dask cluster; the tasks of a worker that dies are done again by another."""
    try:
        import dask as library
        import distributed
    except ImportError:
        raise InputError("dask", "the package dask[distributed]", "an installation without it") from None
    failures = {"distributed.scheduler.allowed-failures": TRIES}
    with library.config.set(failures), _client(distributed.Client, dask, width) as client:
        threads = sum(client.nthreads().values())
        try:
            yield _Pool(client.get_executor(pure=False), max(threads, 1))
        except (distributed.KilledWorker, CancelledError) as error:
            received = str(error) or "a scheduler that went away"
            raise InputError("dask", "a cluster that lives as long as the work", received) from None


def _client(connect: Callable[..., Any], dask: str, width: int) -> Any:
    """Connect to a scheduler, or start a cluster of this many single-threaded processes."""
    expected = "the address of a dask scheduler, or 'local'"
    if not dask:
        raise InputError("dask", expected, repr(dask))
    try:
        if dask != "local":
            return connect(dask, timeout=PATIENCE, set_as_default=False)
        own = {"n_workers": width, "threads_per_worker": 1, "processes": True, "set_as_default": False}
        with _children_deaf_to_interrupts():
            return connect(**own, dashboard_address=":0", silence_logs=logging.CRITICAL)
    except (OSError, ValueError) as error:
        raise InputError("dask", expected, f"{dask!r} ({error})") from None


@contextmanager
def _children_deaf_to_interrupts() -> Iterator[None]:
    """Ctrl-C goes to every process of a terminal; what is started here leaves it to us."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)

"""Spread the work of a comparison over threads or a cluster, keep what is done, go on where it stopped."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from typing import Any

from securestate._checks import whole_number
from securestate.errors import InputError
from securestate.simulation._identity import code_key, digest
from securestate.simulation._store import Kept, Store
from securestate.simulation._work import GROUP, Done, Task, groups_of, work
from securestate.simulation.scenario import Recipe, Scenario

#: Groups of a task at most, so that the last tasks do not take long while other workers wait.
BUNDLE = 10
#: Tasks waiting per worker, so that none is idle while results are kept.
AHEAD = 2
#: How often a task is tried again when its worker dies.
TRIES = 20

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
    """
    tasks = deque(_missing(scenarios, recipes, store))
    total = len(recipes) * sum(len(groups_of(scenario)) for scenario in scenarios)
    done = total - sum(len(task.recipes) * len(task.groups) for task in tasks)
    tell = progress or (lambda *_: None)
    tell(done, total)
    if not tasks:
        return
    with _executor(workers, dask) as (executor, width):
        running: dict[Future[Outcome], Task] = {}
        try:
            while tasks or running:
                while tasks and len(running) < AHEAD * width:
                    task = tasks.popleft()
                    running[executor.submit(work, task, alone=dask is not None)] = task
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    task = running.pop(future)
                    results, left = future.result()
                    store.put(_kept(task.scenario, result) for result in results)
                    done += len(results)
                    if left:
                        tasks.appendleft(Task(task.scenario, task.recipes, left, task.code))
                tell(done, total)
        except BaseException:
            for future in running:
                future.cancel()
            raise


def _missing(scenarios: Sequence[Scenario], recipes: Sequence[Recipe], store: Store) -> Iterator[Task]:
    """Tasks for everything that is not kept yet; estimators that lack the same groups share simulations."""
    for scenario in scenarios:
        lacking: dict[tuple[int, ...], list[Recipe]] = {}
        for recipe in recipes:
            have = {kept.group: kept.runs for kept in store.get(cell_key(scenario, recipe))}
            groups = tuple(g for g in groups_of(scenario) if have.get(g) != runs_in(scenario, g))
            if groups:
                lacking.setdefault(groups, []).append(recipe)
        for groups, chosen in lacking.items():
            for start in range(0, len(groups), BUNDLE):
                yield Task(scenario, tuple(chosen), groups[start : start + BUNDLE], code_key())


def _kept(scenario: Scenario, result: Done) -> Kept:
    cell = digest(code_key(), scenario.key, result.recipe)
    runs = runs_in(scenario, result.group)
    return Kept(cell, result.group, runs, result.scores, result.refusal, result.microseconds)


@contextmanager
def _executor(workers: int | None, dask: str | None) -> Iterator[tuple[Executor, int]]:
    """Who does the work, and how many can do it at once."""
    width = os.cpu_count() or 1 if workers is None else workers
    whole_number("workers", width, 1, InputError)
    if dask is not None:
        with _cluster(dask, width) as found:
            yield found
        return
    threads = ThreadPoolExecutor(width, thread_name_prefix="securestate")
    try:
        yield threads, width
    finally:
        threads.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _cluster(dask: str, width: int) -> Iterator[tuple[Executor, int]]:
    """A dask scheduler as an executor; tasks of a worker that dies are done again by another."""
    try:
        import dask as library
        import distributed
    except ImportError:
        raise InputError("dask", "the package dask[distributed]", "an installation without it") from None
    connect: Callable[..., Any] = distributed.Client
    with library.config.set({"distributed.scheduler.allowed-failures": TRIES}):
        try:
            client = connect(**_processes(width)) if dask == "local" else connect(dask, timeout="10s")
        except (OSError, ValueError) as error:
            expected = "the address of a dask scheduler, or 'local'"
            raise InputError("dask", expected, f"{dask!r} ({error})") from None
        with client:
            threads = sum(client.nthreads().values())
            yield client.get_executor(pure=False, retries=TRIES), max(threads, 1)


def _processes(width: int) -> dict[str, object]:
    """A cluster of this many single-threaded processes on this machine."""
    return {
        "n_workers": width,
        "threads_per_worker": 1,
        "processes": True,
        "dashboard_address": None,
        "silence_logs": 50,
    }

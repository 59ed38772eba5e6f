"""Comparisons on a cluster: the same bits, whoever works and whoever dies."""

import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import dask
import distributed
import pytest

import securestate as ss
from securestate.simulation import Comparison, _work, campaign, compare
from tests.simulation.campaigns import assert_same, recipes, saved, scenarios, unhurried

# distributed closes its sockets a little after the cluster; nothing of ours is left open.
pytestmark = [
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


@pytest.fixture(scope="module")
def cluster() -> Iterator[distributed.LocalCluster]:
    """Two worker processes on this machine."""
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0", silence_logs=50
    ) as found:
        yield found


@pytest.fixture(scope="module")
def by_threads() -> Comparison:
    return campaign(scenarios(25), recipes(), workers=2)


def test_a_cluster_gives_the_same_bits_as_threads(
    cluster: distributed.LocalCluster, by_threads: Comparison, tmp_path: Path
) -> None:
    result = campaign(scenarios(25), recipes(), dask=cluster.scheduler_address)
    assert_same(result, by_threads)
    assert saved(result, tmp_path / "cluster") == saved(by_threads, tmp_path / "threads")


def test_a_worker_killed_in_the_middle_changes_no_number(cluster: distributed.LocalCluster) -> None:
    several = [*recipes(), ss.simulation.Recipe("slow", unhurried)]
    expected = campaign(scenarios(25), several, workers=2)
    killed: list[int] = []

    def kill_one(done: int, total: int) -> None:
        """As soon as some results have arrived, while others are being worked on."""
        if 0 < done < total and not killed:
            with distributed.Client(cluster.scheduler_address, set_as_default=False) as client:
                pid = next(iter(client.run(os.getpid).values()))
            os.kill(pid, signal.SIGKILL)
            killed.append(pid)

    result = campaign(scenarios(25), several, dask=cluster.scheduler_address, progress=kill_one)
    assert len(killed) == 1
    assert_same(result, expected)


def test_a_cluster_of_our_own_is_gone_afterwards(by_threads: Comparison) -> None:
    result = campaign(scenarios(25)[:2], recipes(), dask="local", workers=2)
    both = by_threads.table.isel(scenario=slice(2))
    assert (result.table.mse.values == both.mse.values).all()
    with pytest.raises(ValueError, match="No global client found"):
        distributed.get_client()


def test_the_users_own_dask_is_left_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("securestate.simulation._campaign.PATIENCE", "0.5s")
    before = dask.config.get("scheduler", None)
    with pytest.raises(ss.InputError):
        compare(PLANT, ["kalman"], [None], runs=1, steps=5, seed=1, dask="tcp://127.0.0.1:1")
    assert dask.config.get("scheduler", None) == before


def test_a_comparison_that_is_done_needs_no_cluster(tmp_path: Path) -> None:
    first = campaign(scenarios(10)[:1], recipes(), out=tmp_path)
    assert_same(campaign(scenarios(10)[:1], recipes(), out=tmp_path, dask="tcp://nowhere:1"), first)


def test_workers_with_another_version_are_refused() -> None:
    (scenario, *_), chosen = scenarios(10), tuple(recipes())
    with pytest.raises(ss.InputError, match="dask: expected workers with the same version of securestate"):
        _work.work(_work.Task(scenario, chosen, (0,), "another code"), alone=True)


@pytest.mark.parametrize("address", ["", "nonsense", "tcp://127.0.0.1:1"])
def test_a_scheduler_that_does_not_answer_is_named(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("securestate.simulation._campaign.PATIENCE", "0.5s")
    with pytest.raises(ss.InputError, match="dask: expected the address of a dask scheduler"):
        compare(PLANT, ["kalman"], [None], runs=1, steps=5, seed=1, dask=address)


def test_without_dask_it_is_said_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    modules: dict[str, Any] = {"dask": None, "distributed": None}
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)
    with pytest.raises(ss.InputError, match=r"dask: expected the package dask\[distributed\]"):
        compare(PLANT, ["kalman"], [None], runs=1, steps=5, seed=1, dask="local")


PLANT = ss.Plant([[0.9]], [[1.0]], [ss.Sensor(name, C=[1.0], R=1.0) for name in "abc"])

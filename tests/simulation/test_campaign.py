"""The same numbers whoever computes them and however often they are interrupted, and nothing done twice."""

import functools
import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import threadpoolctl

import securestate as ss
from securestate._threads import one_blas_thread
from securestate.attacks import Bias, Drawn
from securestate.attacks.base import SensorAttack
from securestate.simulation import PlantFamily, Recipe, Scenario, _campaign, _work, campaign, compare
from securestate.simulation._campaign import cell_key
from securestate.simulation._identity import code_key
from tests.simulation.campaigns import (
    FAMILY,
    PLANT,
    Counter,
    any_plant,
    assert_same,
    keys,
    recipes,
    saved,
    scenarios,
)


def test_the_number_of_workers_changes_no_bit(tmp_path: Path) -> None:
    one = campaign(scenarios(25), recipes(), workers=1)
    two = campaign(scenarios(25), recipes(), workers=2)
    assert_same(one, two)
    assert saved(one, tmp_path / "one") == saved(two, tmp_path / "two")


def test_the_order_and_company_of_scenarios_and_estimators_change_no_bit() -> None:
    straight = campaign(scenarios(12), recipes(), workers=2)
    back = campaign(scenarios(12)[::-1], recipes()[::-1], workers=1)
    order = {axis: straight.table[axis].values for axis in ("scenario", "estimator")}
    assert_same(straight, replace(back, table=back.table.sel(order), sensors=straight.sensors))
    alone = campaign(scenarios(12)[2:3], recipes()[:1])
    part = straight.table.sel(scenario=["drawn"], estimator=["oracle", "kalman"])
    assert_same(replace(alone, sensors=straight.sensors), replace(straight, table=part))


def test_more_runs_go_on_from_fewer_without_doing_a_finished_group_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scratch = saved(campaign(scenarios(40), recipes()), tmp_path / "scratch")
    counter = Counter(monkeypatch)
    fewer = campaign(scenarios(25), recipes(), out=tmp_path / "out")
    cells = 5 * 3
    assert len(counter.done) == len(set(counter.done)) == cells * 3
    counter.done.clear()
    more = campaign(scenarios(40), recipes(), out=tmp_path / "out")
    assert sorted({group for *_, group in counter.done}) == [2, 3]  # the third one had five runs only
    assert len(counter.done) == cells * 2
    assert saved(more, tmp_path / "more") == scratch
    counter.done.clear()
    assert_same(campaign(scenarios(25), recipes(), out=tmp_path / "out"), fewer)
    assert counter.done == []


def test_an_interrupt_loses_no_finished_group_and_the_same_call_computes_only_what_lacks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_campaign, "BUNDLE", 1)
    expected = saved(campaign(scenarios(40), recipes()), tmp_path / "expected")
    counter = Counter(monkeypatch)
    told = []

    def interrupt(done: int, total: int) -> None:
        told.append((done, total))
        if done > total // 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        campaign(scenarios(40), recipes(), workers=2, out=tmp_path / "out", progress=interrupt)
    before = list(counter.done)
    done, total = told[-1]
    assert total == 5 * 3 * 4
    assert done <= len(before) < total
    told.clear()
    counter.done.clear()
    result = campaign(scenarios(40), recipes(), out=tmp_path / "out", progress=lambda *now: told.append(now))
    assert told[0] == (len(before), total)
    assert told[-1] == (total, total)
    assert set(counter.done).isdisjoint(before)
    assert len(counter.done) == total - len(before)
    assert saved(result, tmp_path / "out") == expected


def test_progress_never_goes_back_and_ends_with_everything() -> None:
    told: list[tuple[int, int]] = []
    campaign(scenarios(25), recipes(), workers=2, progress=lambda *now: told.append(now))
    assert told[0] == (0, 45)
    assert told[-1] == (45, 45)
    assert told == sorted(told)


def broken(plant: ss.Plant) -> ss.KalmanFilter:
    raise ZeroDivisionError(plant.name)


def test_a_bug_in_a_design_comes_through_and_finished_groups_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    counter = Counter(monkeypatch)
    campaign(scenarios(20)[:2], recipes(), out=tmp_path)
    with pytest.raises(ZeroDivisionError, match="five"):
        campaign(scenarios(20)[:3], [*recipes(), Recipe("broken", broken)], workers=1, out=tmp_path)
    counter.done.clear()
    campaign(scenarios(20)[:2], recipes(), out=tmp_path)
    assert counter.done == []


def test_what_has_no_steady_state_or_refuses_the_prior_is_left_out_with_its_reason() -> None:
    prior = ss.Belief([0.0], [[1e4]])
    given = Scenario("cold", PLANT, Bias(5.0, on="b"), 20, 12, seed=1, prior=prior)
    table = campaign([given, scenarios(12)[1]], recipes()).table
    assert "sparse fusion runs in steady state" in str(
        table.refusal.sel(scenario="cold", estimator="sparse").item()
    )
    figures = [name for name, held in table.data_vars.items() if held.dtype.kind == "f"]
    cold = table.sel(scenario="cold")
    assert all(cold[name].sel(estimator="sparse").isnull().all() for name in figures)
    assert all(cold.mse.sel(estimator=["oracle", "kalman"]) > 0)
    assert (table.refusal != "").sum() == 1
    alone = campaign([given], recipes()[:1]).table
    assert alone.mse.sel(estimator="kalman").item() == cold.mse.sel(estimator="kalman").item()


def refuses_some(plant: ss.Plant) -> ss.KalmanFilter:
    if plant.A[0, 0] > 0.65:
        raise ss.DesignError("too slow for me")
    return ss.KalmanFilter(plant)


def test_an_estimator_that_refuses_some_plants_of_a_family_counts_for_none() -> None:
    result = campaign(scenarios(25)[2:3], [Recipe("picky", refuses_some)])
    cell = result.table.sel(scenario="drawn", estimator="picky")
    assert cell.refusal.item() == "too slow for me"
    assert np.isnan(cell.ratio.item())
    assert set(result.sensors["estimator"]) == {"oracle"}


def test_a_scenario_that_cannot_be_simulated_is_named() -> None:
    wrong = Scenario("nobody there", PLANT, Bias(1.0, on="z"), 20, 5, seed=1)
    with pytest.raises(ss.InputError, match=r"scenario 'nobody there': on: expected a sensor of the plant"):
        campaign([wrong], recipes())


def test_estimators_and_scenarios_that_differ_in_name_only_are_computed_once_and_agree(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    counter = Counter(monkeypatch)
    bias = scenarios(12)[1]
    table = campaign(
        [bias, replace(bias, name="again"), replace(bias, name="longer", runs=25)],
        [Recipe("one", ss.KalmanFilter), Recipe("two", ss.KalmanFilter)],
    ).table
    # groups of 10 and 2 runs, and for the longer one those of 10 and 5
    assert len(counter.done) == 2 * (2 + 2)
    assert table.runs.sel(estimator="two").values.tolist() == [12, 12, 25]
    for name in ("mse", "ratio", "ratio_high", "nis"):
        assert table[name].sel(scenario="bias", estimator="one") == table[name].sel(
            scenario="again", estimator="two"
        )


def test_lambdas_are_told_apart() -> None:
    both = [
        Recipe("k", lambda plant: ss.KalmanFilter(plant)),
        Recipe("s", lambda plant: ss.SparseFusion(plant)),
    ]
    table = campaign(scenarios(10)[1:2], both).table
    named = campaign(scenarios(10)[1:2], [Recipe("k", ss.KalmanFilter), Recipe("s", ss.SparseFusion)]).table
    np.testing.assert_array_equal(table.mse, named.mse)


@pytest.mark.parametrize(
    "recipe",
    [
        Recipe("mine", lambda plant: ss.KalmanFilter(plant)),
        Recipe("mine", functools.partial(lambda plant: ss.KalmanFilter(plant))),
        Recipe("mine", ss.KalmanFilter, {"helper": object()}),
    ],
)
def test_what_another_process_cannot_recognise_is_refused_with_out(tmp_path: Path, recipe: Recipe) -> None:
    with pytest.raises(
        ss.InputError, match=r"estimators: expected .* because out is given .* received 'mine'"
    ):
        campaign(scenarios(10)[:1], [recipe], out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_family_with_a_lambda_is_refused_with_out(tmp_path: Path) -> None:
    family = PlantFamily("mine", lambda rng: any_plant(rng))
    scenario = Scenario("mine", family, None, 9, 9, seed=1)
    with pytest.raises(ss.InputError, match=r"scenarios: expected .* received 'mine'"):
        campaign([scenario], recipes(), out=tmp_path)
    assert campaign([scenario], recipes()).table.mse.notnull().all()


BASE = Scenario("base", PLANT, Bias(5.0, on=Drawn(2), start=3), 20, 25, seed=1, score_from=5)
SPARSE = Recipe("sparse", ss.SparseFusion, {"kalman_probability": 0.9})


def with_a(value: float) -> ss.Plant:
    return ss.Plant([[value]], PLANT.Q, PLANT.sensors, name=PLANT.name)


@pytest.mark.parametrize(
    "change",
    [
        {"plant": with_a(np.nextafter(0.9, 1.0))},
        {"plant": FAMILY},
        {
            "plant": ss.Plant(
                [[0.9]], [[1.0]], [ss.Sensor(n, C=[1.0], R=1.0, protected=n == "a") for n in "abcde"]
            )
        },
        {"attack": None},
        {"attack": Bias(5.0 + 1e-15, on=Drawn(2), start=3)},
        {"attack": Bias(5.0, on=Drawn((1, 2)), start=3)},
        {"attack": Bias(5.0, on=Drawn(2, among=["a", "b", "c"]), start=3)},
        {"attack": Bias(5.0, on=Drawn(2), start=4)},
        {"attack": Bias(5.0, on=Drawn(2), start=3, signs="random")},
        {"attack": Bias(5.0, on=Drawn(2), start=3) + Bias(1.0, on="a")},
        {"seed": 2},
        {"steps": 21},
        {"score_from": 4},
        {"prior": ss.Belief([0.0])},
        {"prior": ss.Belief([0.0], [[1.0]])},
    ],
)
def test_whatever_changes_the_data_changes_the_key(change: dict[str, object]) -> None:
    assert cell_key(replace(BASE, **change), SPARSE) != cell_key(BASE, SPARSE)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "other",
    [
        Recipe("sparse", ss.KalmanFilter),
        Recipe("sparse", ss.SparseFusion),
        Recipe("sparse", ss.SparseFusion, {"kalman_probability": 0.91}),
        Recipe("sparse", ss.SparseFusion, {"kalman_probability": 0.9, "refit": False}),
        Recipe("sparse", functools.partial(ss.SparseFusion, kalman_probability=0.91)),
    ],
)
def test_whatever_changes_an_estimator_changes_the_key(other: Recipe) -> None:
    assert cell_key(BASE, other) != cell_key(BASE, SPARSE)


def test_names_and_the_number_of_runs_do_not_change_the_key() -> None:
    renamed = replace(BASE, name="x", plant_name="y", attack_name="z", runs=99)
    swapped = Recipe("other", ss.SparseFusion, dict(reversed([("refit", True), ("kalman_probability", 0.9)])))
    straight = Recipe("sparse", ss.SparseFusion, {"kalman_probability": 0.9, "refit": True})
    assert cell_key(renamed, swapped) == cell_key(BASE, straight)
    family = replace(BASE, plant=FAMILY)
    assert replace(family, plant=replace(FAMILY, name="other")).key == family.key
    assert replace(family, plant=replace(FAMILY, runs_per_plant=4)).key != family.key


def test_long_arrays_differ_in_any_entry() -> None:
    first, second = np.zeros(5000), np.zeros(5000)
    second[2500] = 1.0
    assert Recipe("a", ss.KalmanFilter, {"w": first}).key != Recipe("a", ss.KalmanFilter, {"w": second}).key


def test_other_code_has_other_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    before = cell_key(BASE, SPARSE)
    monkeypatch.setattr(_campaign, "code_key", lambda: "other")
    assert cell_key(BASE, SPARSE) != before


def test_another_process_finds_the_same_keys() -> None:
    code = "import json; from tests.simulation.campaigns import keys; print(json.dumps(keys()))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    mine = keys()
    assert json.loads(done.stdout) == mine
    assert len(set(mine.values())) == len(mine)


@pytest.mark.parametrize("budget", [0.0, 1e9])
def test_work_hands_back_exactly_the_groups_that_it_has_not_done(budget: float) -> None:
    task = _work.Task(scenarios(50)[1], tuple(recipes()), (0, 2, 3), code_key())
    done, left = _work.work(task, alone=False, budget=budget)
    groups = [0] if budget == 0 else [0, 2, 3]
    assert [(one.recipe, one.group) for one in done] == [(r.key, g) for g in groups for r in recipes()]
    assert left == ((2, 3) if budget == 0 else ())


def test_slices_of_any_length_give_the_same_bits_and_do_nothing_twice(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    whole = campaign(scenarios(40), recipes())
    monkeypatch.setattr(_work.work, "__kwdefaults__", {"budget": 0.0})
    counter = Counter(monkeypatch)
    assert_same(campaign(scenarios(40), recipes(), workers=2), whole)
    assert len(counter.done) == len(set(counter.done)) == 5 * 3 * 4


def test_time_is_measured_in_the_first_group_only_and_is_in_no_table() -> None:
    task = _work.Task(scenarios(20)[1], tuple(recipes()), (0, 1), code_key())
    done, _ = _work.work(task, alone=False)
    assert [one.microseconds is not None for one in done] == [True, True, False, False]
    result = campaign(scenarios(20)[:1], recipes())
    assert (result.timing > 0).all(axis=None)
    assert "microseconds" not in {
        *result.table.variables,
        *result.sensors.columns,
        *result.to_pandas().columns,
    }


def blas_threads() -> dict[str, int]:
    """Threads of every BLAS that is loaded; other tests may have loaded some that only know one."""
    pools = [pool for pool in threadpoolctl.threadpool_info() if pool["user_api"] == "blas"]
    return {pool["filepath"]: pool["num_threads"] for pool in pools}


def test_blas_has_one_thread_until_the_last_task_ends_and_then_as_many_as_before() -> None:
    with threadpoolctl.threadpool_limits(2, user_api="blas"):
        before = blas_threads()
        assert 2 in before.values()
        first, second = one_blas_thread(), one_blas_thread()
        with first:
            with second:
                assert set(blas_threads().values()) == {1}
            assert set(blas_threads().values()) == {1}
        assert blas_threads() == before
        campaign(scenarios(10)[:2], recipes(), workers=2)
        assert blas_threads() == before


@pytest.mark.parametrize("workers", [0, -1, 1.5, True])
def test_workers_are_checked_even_if_nothing_is_left_to_do(workers: object) -> None:
    with pytest.raises(ss.InputError, match="workers: expected a whole number >= 1"):
        campaign(scenarios(5)[:1], recipes(), workers=workers)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("make", "argument"),
    [
        (lambda: Scenario("x", "plant", None, 9, 9, 1), "plant"),  # type: ignore[arg-type]
        (lambda: Scenario("x", PLANT, "bias", 9, 9, 1), "attack"),  # type: ignore[arg-type]
        (lambda: Scenario("x", PLANT, None, 9, 9, 1, prior=0.0), "prior"),  # type: ignore[arg-type]
        (lambda: Scenario("x", PLANT, None, 0, 9, 1), "steps"),
        (lambda: Scenario("x", PLANT, None, 9, 0, 1), "runs"),
        (lambda: Scenario("x", PLANT, None, 9, 9, -1), "seed"),
        (lambda: Scenario("x", PLANT, None, 9, 9, 1, score_from=9), "score_from"),
        (lambda: campaign([], recipes()), "scenarios"),
        (lambda: campaign([BASE, BASE], recipes()), "scenarios"),
        (lambda: campaign([replace(BASE, name="a\0b")], recipes()), "scenarios"),
        (lambda: campaign([BASE], [SPARSE, SPARSE]), "estimators"),
        (lambda: campaign([BASE], [replace(SPARSE, name="oracle")]), "estimators"),
    ],
)
def test_a_wrong_argument_is_named(make: Callable[[], object], argument: str) -> None:
    with pytest.raises(ss.InputError) as caught:
        make()
    assert caught.value.argument.startswith(argument)


RATE = 0.01
HELD = [object()]


def strict(plant: ss.Plant) -> ss.InnovationGate:
    """Read a constant of this module."""
    return ss.InnovationGate(plant, false_alarm_rate=RATE)


def unreadable(plant: ss.Plant) -> ss.KalmanFilter:
    """Read something of this module that cannot be looked into."""
    assert HELD
    return ss.KalmanFilter(plant)


def test_a_constant_that_an_own_function_reads_is_part_of_its_key(monkeypatch: pytest.MonkeyPatch) -> None:
    before = Recipe("strict", strict)
    assert before.key == Recipe("again", strict).key
    first = before.key
    monkeypatch.setitem(globals(), "RATE", 0.2)
    assert Recipe("strict", strict).key != first


def test_a_function_that_reads_what_cannot_be_looked_into_is_refused_with_out(tmp_path: Path) -> None:
    with pytest.raises(ss.InputError, match="because out is given"):
        campaign(scenarios(10)[:1], [Recipe("unreadable", unreadable)], out=tmp_path)


@dataclass(frozen=True)
class Secretive(SensorAttack):
    """Keeps its size where nobody sees it."""

    def hide(self, size: float) -> "Secretive":
        object.__setattr__(self, "size", size)
        return self

    def inject(self, view: Any) -> Any:
        return vars(self)["size"]


def test_an_adversary_with_attributes_that_are_no_fields_is_refused_with_out(tmp_path: Path) -> None:
    scenario = Scenario("hidden", PLANT, Secretive(on="a").hide(3.0), 20, 10, seed=1)
    assert campaign([scenario], recipes()).table.mse.notnull().all()
    with pytest.raises(ss.InputError, match="because out is given"):
        campaign([scenario], recipes(), out=tmp_path)


def test_an_attack_that_begins_after_the_end_is_refused() -> None:
    with pytest.raises(ss.InputError, match="attack of scenario 'late': expected a start below 20"):
        Scenario("late", PLANT, Bias(1.0, on="a") + Bias(1.0, on="b", start=20), 20, 10, seed=1)


def test_a_function_that_makes_no_estimator_is_named() -> None:
    result = campaign(scenarios(10)[:1], [Recipe("nothing", noted)])
    assert "estimator 'nothing': expected a function that returns an Estimator" in str(
        result.table.refusal.sel(estimator="nothing").values
    )


def noted(plant: ss.Plant) -> Any:
    """Forget to return anything."""
    ss.KalmanFilter(plant)


def test_what_is_bound_shows_in_a_name() -> None:
    given = [functools.partial(ss.InnovationGate, false_alarm_rate=0.001), ss.KalmanFilter]
    result = compare(PLANT, given, [None], runs=1, steps=5, seed=1)
    assert list(result.table.estimator.values) == [
        "oracle",
        "InnovationGate(false_alarm_rate=0.001)",
        "KalmanFilter",
    ]

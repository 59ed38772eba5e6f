"""Who is attacked, and when."""

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from securestate import InputError, Plant, Sensor
from securestate.attacks import Bias, Cycle, Drawn, Fixed, Redrawn, Switching, Targets
from tests.attacks.scenes import scene, vehicle


def plant_of(protected: list[bool]) -> Plant:
    sensors = [Sensor(f"s{i}", C=[1.0], R=1.0, protected=p) for i, p in enumerate(protected)]
    return Plant([[0.9]], [[1.0]], sensors)


def rng() -> np.random.Generator:
    return np.random.default_rng(7)


@given(st.data())
def test_never_more_than_asked_for_and_never_a_protected_one(data: st.DataObject) -> None:
    protected = data.draw(st.lists(st.booleans(), min_size=1, max_size=8))
    free = protected.count(False)
    high = data.draw(st.integers(0, free))
    low = data.draw(st.integers(0, high))
    steps = data.draw(st.integers(1, 30))
    kind = data.draw(st.sampled_from(["drawn", "redrawn", "switching"]))
    rules = {
        "drawn": Drawn((low, high)),
        "redrawn": Redrawn((low, high)),
        "switching": Switching((low, high), every=data.draw(st.integers(1, 40))),
    }
    numbers = np.random.default_rng(data.draw(st.integers(0, 99)))
    chosen = rules[kind].choose(plant_of(protected), steps, numbers)
    assert chosen.shape == (steps, len(protected))
    assert np.all(chosen.sum(axis=1) <= high)
    assert np.all(chosen.sum(axis=1) >= low)
    assert not np.any(chosen[:, protected])


def test_fixed_sensors_are_the_same_at_all_times() -> None:
    for names in ("gps", 2, ["gps"], (2,), np.array([2])):
        staged = Bias(1.0, on=names, start=0).stage(scene(vehicle()))  # type: ignore[arg-type]
        assert np.all(staged.attacked == [False, False, True, False])
    assert Fixed(["y", 0]).indices(vehicle()) == [0, 1]


def test_a_drawn_set_stays_for_a_run_and_differs_between_runs() -> None:
    staged = Bias(1.0, on=Drawn(2)).stage(scene(vehicle(), runs=50))
    assert np.all(staged.attacked == staged.attacked[:, :1])
    assert {tuple(row) for row in staged.attacked[:, 0, :3]} == {
        (True, True, False),
        (True, False, True),
        (False, True, True),
    }


def test_a_redrawn_set_is_uniform_in_size_and_members() -> None:
    chosen = Redrawn((1, 6)).choose(plant_of([False] * 10), 60000, rng())
    sizes = np.bincount(chosen.sum(axis=1), minlength=11)
    np.testing.assert_allclose(sizes[1:7] / 60000, 1 / 6, atol=0.01)
    np.testing.assert_allclose(chosen.mean(axis=0), 0.35, atol=0.01)
    again = np.mean(np.all(chosen[1:] == chosen[:-1], axis=1))
    assert again < 0.05


def test_a_switching_set_changes_only_every_so_many_samples() -> None:
    chosen = Switching(2, every=7).choose(plant_of([False] * 9), 100, rng())
    changes = np.flatnonzero(np.any(chosen[1:] != chosen[:-1], axis=1)) + 1
    assert len(changes) > 5
    assert np.all(changes % 7 == 0)


def test_a_cycle_goes_through_its_sets() -> None:
    chosen = Cycle([["x", "y"], [], "gps"], every=2).choose(vehicle(), 9)
    rows = [[1, 1, 0, 0]] * 2 + [[0, 0, 0, 0]] * 2 + [[0, 0, 1, 0]] * 2 + [[1, 1, 0, 0]] * 2 + [[0, 0, 0, 0]]
    np.testing.assert_array_equal(chosen, np.array(rows, dtype=bool))


def test_among_limits_the_choice() -> None:
    chosen = Redrawn(1, among=["x", "gps"]).choose(vehicle(), 200, rng())
    assert chosen[:, 0].any()
    assert chosen[:, 2].any()
    assert not chosen[:, [1, 3]].any()


@pytest.mark.parametrize(
    "rule", [Fixed("x"), Cycle(["x", "y"], 3), Drawn(2), Redrawn((1, 2), among=["x", 1]), Switching(1, 4)]
)
def test_a_rule_is_a_value(rule: Targets) -> None:
    assert pickle.loads(pickle.dumps(rule)) == rule
    assert isinstance(hash(rule), int)


def test_a_list_and_a_tuple_make_the_same_rule() -> None:
    assert Redrawn([1, 2], among=["x"]) == Redrawn((1, 2), among=("x",))  # type: ignore[arg-type]
    assert Fixed("x") == Fixed(["x"])


@pytest.mark.parametrize(
    ("rule", "message"),
    [
        (Fixed("z"), r"on: expected a sensor of the plant \(x, y, gps, speed\), received 'z'"),
        (Fixed(4), r"on: expected an index in 0..3, received 4"),
        (Fixed(-1), r"on: expected an index in 0..3, received -1"),
        (Fixed("speed"), "on: expected sensors that are not protected, received 'speed'"),
        (Drawn(4), "count: expected at most 3, the sensors there are to choose from, received 4"),
        (Redrawn(1, among=["speed"]), "among: expected sensors that are not protected"),
        (Cycle(["z"], 3), "sets: expected a sensor of the plant"),
    ],
)
def test_what_the_plant_does_not_have_is_refused(rule: Targets, message: str) -> None:
    with pytest.raises(InputError, match=message):
        rule.choose(vehicle(), 10, rng())


def test_a_drawn_rule_needs_a_generator() -> None:
    with pytest.raises(InputError, match=r"rng: expected a numpy.random.Generator"):
        Drawn(1).choose(vehicle(), 10, None)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Drawn(-1), "count: expected a whole number >= 0"),
        (lambda: Drawn(1.5), "count: expected a whole number >= 0"),
        (lambda: Redrawn((3, 2)), "count: expected a whole number >= 3, received 2"),
        (lambda: Redrawn((1, 2, 3)), r"count: expected a whole number >= 0, or a pair \(low, high\)"),
        (lambda: Switching(1, 0), "every: expected a whole number >= 1"),
        (lambda: Cycle([], 1), "sets: expected a list of sets of sensors"),
        (lambda: Cycle("x", 1), "sets: expected a list of sets of sensors"),
        (lambda: Cycle(["x"], 0), "every: expected a whole number >= 1"),
        (lambda: Drawn(1, among=[1.5]), "among: expected sensor names, indices"),
    ],
)
def test_a_wrong_rule_is_refused(make: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()  # type: ignore[operator]

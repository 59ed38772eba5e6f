"""Advice: it works, nothing smaller does, and the changed plant is the old one with the change."""

from itertools import combinations, combinations_with_replacement

import numpy as np
import pytest

from securestate import InputError, Plant, Sensor
from securestate.resilience import limit, options, smallest_protection
from tests.estimators.sparse_cases import liu
from tests.reference.resilience import random_case
from tests.resilience.test_limit import GOLDEN, dc_grid, plant_of


def cases(count: int) -> list[Plant]:
    """Random plants of at most six sensors that are detectable and have a limit to raise."""
    rng, found = np.random.default_rng(31), []
    while len(found) < count:
        plant = plant_of(random_case(rng, large_spaces=len(found) % 2 == 0))
        if plant.n_sensors <= 6 and plant.n <= 4 and limit(plant, 0.0).lower > 0:
            found.append(plant)
    return found


def enough(plant: Plant, attacked: int) -> bool:
    return limit(plant, 0.0).max_attacked >= attacked or limit(plant, 0.0).lower >= 2 * attacked + 1


def changed(plant: Plant, kind: str, chosen: tuple[int, ...]) -> Plant:
    if kind == "protect":
        return plant.with_protected(chosen)
    if kind == "copy":
        return plant.with_sensors(plant.sensors[i].replaced(name=f"extra {k}") for k, i in enumerate(chosen))
    return plant.with_sensors(Sensor(f"extra {k}", C=np.eye(plant.n)[i], R=1.0) for k, i in enumerate(chosen))


def smaller_sets(plant: Plant, kind: str, size: int) -> list[tuple[int, ...]]:
    if kind == "protect":
        return list(combinations(range(plant.n_sensors), size))
    return list(combinations_with_replacement(range(plant.n_sensors if kind == "copy" else plant.n), size))


def test_every_option_raises_the_limit_and_nothing_smaller_of_its_kind_does() -> None:
    kinds = set()
    for plant in cases(12):
        now = limit(plant, 0.0)
        goal = now.max_attacked + 1
        for option in options(now, goal):
            kinds.add(option.kind)
            assert enough(option.plant, goal), option
            assert option.fewest
            if option.total <= 3:
                for chosen in smaller_sets(plant, option.kind, option.total - 1):
                    assert not enough(changed(plant, option.kind, chosen), goal), (option, chosen)
    assert kinds == {"copy", "measure", "protect"}


def test_the_smallest_protection_sees_every_mode_and_nothing_smaller_does() -> None:
    for plant in cases(15):
        found = smallest_protection(limit(plant, 0.0))
        assert found is not None
        names, fewest = found
        assert fewest
        chosen = [plant.sensor_names.index(name) for name in names]
        assert limit(plant.select(chosen), 0.0).lower > 0
        for fewer in combinations(range(plant.n_sensors), len(chosen) - 1):
            assert not fewer or limit(plant.select(fewer), 0.0).lower == 0


def test_advice_for_the_example_of_liu_is_golden() -> None:
    now = limit(liu())
    ways = {option.kind: option for option in options(now, 2)}
    assert ways["copy"].total == GOLDEN["liu"]["copies_to_p2"]
    protection = smallest_protection(now)
    assert protection is not None
    assert len(protection[0]) == GOLDEN["liu"]["protect"]


@pytest.mark.parametrize("case", ["case14", "case39", "case118"])
def test_advice_for_the_grids_is_golden(case: str) -> None:
    now = limit(dc_grid(case), 0.0)
    ways = {option.kind: option for option in options(now, 2)}
    golden = GOLDEN["grids"][case]
    assert (ways["copy"].total, ways["measure"].total) == (golden["copies"], golden["angles"])
    assert all(option.fewest and limit(option.plant, 0.0).max_attacked >= 2 for option in ways.values())
    protection = smallest_protection(now)
    assert protection is not None
    assert len(protection[0]) == golden["protect"]


def test_the_grid_of_14_buses_needs_one_change_at_bus_8() -> None:
    told = [str(option) for option in options(limit(dc_grid("case14"), 0.0), 2)]
    assert sorted(told) == ["duplicate injection 8", "measure angle of bus 8", "protect injection 8"]


def test_a_mode_that_nobody_sees_asks_for_a_new_sensor() -> None:
    plant = Plant(np.eye(2), np.eye(2), [Sensor("a", C=[1.0, 0.0], R=1.0)], state_names=["level", "heat"])
    now = limit(plant)
    assert now.max_attacked == -1
    (option,) = options(now, 0)
    assert (option.kind, str(option)) == ("measure", "measure heat")
    assert limit(option.plant).max_attacked == 0
    assert smallest_protection(now) is None


def test_copies_keep_what_they_copy_and_no_name_is_given_twice() -> None:
    R = np.array([[1.0, 0.5, 0.0], [0.5, 2.0, 0.0], [0.0, 0.0, 3.0]])
    sensors = [
        Sensor("pair", C=np.eye(2), channels=["pair.low", "pair.high"], scale=[2.0, 3.0], unit="m"),
        Sensor("pair (copy)", C=[1.0, 1.0]),
    ]
    plant = Plant(np.eye(2), np.eye(2), sensors, R=R, B=np.ones((2, 1)), D=np.arange(3.0)[:, None])
    option = next(option for option in options(limit(plant), 1) if option.kind == "copy")
    after = option.plant
    assert len(set(after.sensor_names)) == after.n_sensors == 2 + option.total
    for name in after.sensor_names[2:]:
        i = after.sensor_names.index(name)
        original = len(after.sensors[i].channels) == 1
        own, rows = plant.channels_of(original), after.channels_of(i)
        for attribute in ("C", "D", "scale", "offset"):
            np.testing.assert_array_equal(getattr(after, attribute)[rows], getattr(plant, attribute)[own])
        np.testing.assert_array_equal(after.R[rows, rows], plant.R[own, own])
        assert not after.R[rows, : plant.m].any()
    np.testing.assert_array_equal(after.R[: plant.m, : plant.m], plant.R)


def test_there_is_no_advice_where_everybody_may_lie_or_enough_are_survived() -> None:
    assert options(limit(liu()), 1) == ()
    assert options(limit(liu().with_protected([0, 1])), 4) == ()
    assert smallest_protection(limit(liu().with_protected([0, 1]))) == ((), True)
    with pytest.raises(InputError, match="attacked: expected a whole number >= 0"):
        options(limit(liu()), -1)

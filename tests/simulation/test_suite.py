"""Suites: every key does what the page says, and every mistake is named by file, table and key."""

import copy
import json
import textwrap
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import securestate as ss
from securestate.attacks import (
    Bias,
    DefenderReflection,
    Delay,
    Denial,
    Drawn,
    FakeState,
    Fixed,
    Freeze,
    NoiseLinear,
    Pulse,
    Ramp,
    RandomNoise,
    RandomWalk,
    Redrawn,
    Reflection,
    Sinusoid,
    Switching,
)
from securestate.attacks.base import Combination, SingleAttack
from securestate.estimators import METHODS
from securestate.plant import Plant
from securestate.simulation import FAMILIES, PlantFamily, Scenario, campaign, suite
from securestate.simulation.suite import load_suite
from tests.simulation.campaigns import PLANT

ARENA = Path(__file__).parents[2] / "examples" / "arena" / "suite.toml"
CELLS = Path(__file__).parents[1] / "cases" / "arena" / "cells.json"

SMALL = """
[suite]
runs = 12
steps = 20
score_from = 5
seed = 1
[[plant]]
name = "five"
file = "five.toml"
[[attack]]
name = "bias"
kind = "bias"
size = 5.0
on = "b"
"""


PARTS = 'parts = [{ kind = "denial", on = "a" }]'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a plant in it."""
    PLANT.save(tmp_path / "five.toml")
    return tmp_path


def written(folder: Path, text: str) -> Path:
    path = folder / "suite.toml"
    path.write_text(text, encoding="utf-8")
    return path


def documented(folder: Path) -> Path:
    """Write the example of the page, and the plant that it names."""
    PLANT.save(folder / "tanks.toml")
    page = str(suite.__doc__)
    example = page[page.index("    [suite]") : page.index("`on` is")]
    return written(folder, textwrap.dedent(example))


def test_the_documented_example_means_what_it_says(folder: Path) -> None:
    loaded = load_suite(documented(folder))
    assert loaded.name == "Two tanks"
    (only,) = loaded.scenarios
    assert (only.name, only.plant_name) == ("scalar: bias 5, 1-6 changing, cold start", "scalar")
    assert only.attack == Bias(5.0, on=Redrawn((1, 6)), start=0)
    assert (only.runs, only.steps, only.score_from, only.seed) == (20, 130, 30, 1)
    assert only.prior == ss.Belief([0.0], [[1e4]])
    assert isinstance(only.plant, PlantFamily)
    assert (only.plant.rule, only.plant.runs_per_plant) == (FAMILIES["scalar"], 10)
    (recipe,) = loaded.recipes
    assert recipe.name == "sparse 0.9"
    assert recipe(PLANT).settings["kalman_probability"] == 0.9


def test_without_scenarios_every_attack_meets_every_plant_and_every_method(folder: Path) -> None:
    text = documented(folder).read_text()
    text = text[: text.index("[[scenario]]")].replace('family = "scalar"', 'file = "tanks.toml"')
    loaded = load_suite(written(folder, text))
    assert [one.name for one in loaded.scenarios] == [
        "tanks: bias 5, 2 fixed",
        "tanks: bias and silence",
        "scalar: bias 5, 2 fixed",
        "scalar: bias and silence",
    ]
    tanks = loaded.scenarios[0]
    assert tanks.plant == PLANT
    assert tanks.attack == Bias(5.0, on=Drawn(2), start=30)
    both = loaded.scenarios[1].attack
    assert both == Combination((Bias(5.0, on="a", start=30), Denial(on="b", start=30)))
    assert [(recipe.name, recipe.design) for recipe in loaded.recipes] == [
        (name, method.design) for name, method in METHODS.items()
    ]
    assert {one.runs for one in loaded.scenarios} == {200}


@pytest.mark.parametrize(
    ("on", "expected", "label"),
    [
        ('"a"', Fixed(("a",)), "on a"),
        ('["a", "c"]', Fixed(("a", "c")), "on a, c"),
        ("{ drawn = 3 }", Drawn(3), "3 fixed"),
        ("{ drawn = [1, 3] }", Drawn((1, 3)), "1-3 fixed"),
        ("{ redrawn = [1, 3] }", Redrawn((1, 3)), "1-3 changing"),
        ("{ switching = 3, every = 20 }", Switching(3, 20), "3 switching"),
        ('{ redrawn = 1, among = ["a", "b"] }', Redrawn(1, among=("a", "b")), "1 changing"),
        ("{ drawn = 0 }", Drawn(0), "0 fixed"),
    ],
)
@pytest.mark.parametrize("place", ["attack", "scenario"])
def test_targets_are_what_their_table_says_in_an_attack_or_a_scenario(
    folder: Path, on: str, expected: object, label: str, place: str
) -> None:
    text = SMALL.replace('on = "b"', f"on = {on}")
    if place == "scenario":
        text = SMALL + f'[[scenario]]\nplant = "five"\nattacks = ["bias"]\non = {on}\n'
    (only,) = load_suite(written(folder, text)).scenarios
    assert isinstance(only.attack, Bias)
    assert only.attack.on == expected
    assert only.name == f"five: bias, {label}"


@pytest.mark.parametrize(
    ("attack", "scenario", "start"), [("", "", 5), ("start = 7", "", 7), ("start = 7", "start = 0", 0)]
)
def test_the_start_is_that_of_the_scenario_else_of_the_attack_else_where_scores_begin(
    folder: Path, attack: str, scenario: str, start: int
) -> None:
    text = f'{SMALL}{attack}\n[[scenario]]\nplant = "five"\nattacks = ["bias"]\n{scenario}\n'
    (only,) = load_suite(written(folder, text)).scenarios
    assert isinstance(only.attack, Bias)
    assert only.attack.start == start


def test_a_label_stands_instead_of_the_targets_and_runs_are_the_fewer_ones(folder: Path) -> None:
    text = f'{SMALL}stop = 9\n[[scenario]]\nplant = "five"\nattacks = ["bias"]\nlabel = "x"\nruns = 10\n'
    for asked, runs in ((None, 10), (5, 5), (100, 10)):
        (only,) = load_suite(written(folder, text), runs=asked).scenarios
        assert (only.name, only.runs) == ("five: bias, x", runs)
    assert only.attack == Bias(5.0, on="b", start=5, stop=9)


def test_a_suite_gives_the_numbers_of_the_same_objects(folder: Path) -> None:
    loaded = load_suite(written(folder, SMALL + '[[estimator]]\nmethod = "kalman"\n'))
    same = Scenario("five: bias, on b", PLANT, Bias(5.0, on="b", start=5), 20, 12, seed=1, score_from=5)
    first = campaign(loaded.scenarios, loaded.recipes).table
    second = campaign([same], loaded.recipes).table
    np.testing.assert_array_equal(first.mse, second.mse)


def with_lines(*lines: str) -> str:
    return SMALL + "\n".join(lines) + "\n"


ATTACK = ("[[attack]]", 'name = "x"')
SCENARIO = ("[[scenario]]", 'plant = "five"', 'attacks = ["bias"]')


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (SMALL.replace("runs = 12", ""), ["suite runs", "received nothing"]),
        (SMALL.replace("runs = 12", "runs = 0"), ["suite runs", "received 0"]),
        (SMALL.replace("runs = 12", 'runs = "12"'), ["suite runs", "received '12'"]),
        (SMALL.replace("runs = 12", "runs = 12.0"), ["suite runs", "received 12.0"]),
        (SMALL.replace("runs = 12", "runs = true"), ["suite runs", "received True"]),
        (SMALL.replace("seed = 1", "seed = -1"), ["suite seed", "received -1"]),
        (SMALL.replace("score_from = 5", "score_from = 20"), ["suite", "score_from below steps"]),
        (
            SMALL.replace("seed = 1", "seed = 1\nsed = 2"),
            ["suite sed", "a key among runs, steps, seed", "seed?"],
        ),
        (SMALL.replace("[suite]", "[sweet]"), ["suite", "received nothing"]),
        (with_lines("[extra]"), ["extra"]),
        (SMALL.replace('name = "five"', ""), ["plant number 1 name", "received nothing"]),
        (SMALL.replace('name = "five"', 'name = ""'), ["plant number 1 name"]),
        (SMALL.replace('name = "five"', 'name = "a\\u0000b"'), ["plant number 1 name"]),
        (SMALL.replace('file = "five.toml"', ""), ["plant 'five'", "either file or family", "neither"]),
        (SMALL.replace('file = "five.toml"', 'file = ""\nfamily = "scalar"'), ["plant 'five'", "both"]),
        (SMALL.replace('file = "five.toml"', 'family = "none"'), ["plant 'five': family", "'none'"]),
        (SMALL.replace("five.toml", "six.toml"), ["plant 'five': six.toml: ", "plant file", "nothing there"]),
        (SMALL.replace("five.toml", "suite.toml"), ["plant 'five': suite.toml: ", "unknown"]),
        (SMALL.replace("five.toml", "a\\u0000b"), ["plant 'five'"]),
        (with_lines("[[plant]]", 'name = "five"', 'family = "scalar"'), ["[[plant]] name", "'five' twice"]),
        (with_lines("[[attack]]", 'name = "bias"', 'kind = "none"'), ["[[attack]] name", "'bias' twice"]),
        (
            SMALL.replace('kind = "bias"', 'kind = "buy us"'),
            ["attack 'bias': kind", "one of bias,", "'buy us'"],
        ),
        (SMALL.replace('on = "b"', ""), ["attack 'bias': on", "who is attacked"]),
        (SMALL.replace('on = "b"', 'on = "z"'), ["five: bias, on z", "on", "a sensor of the plant", "'z'"]),
        (SMALL.replace('on = "b"', "on = []"), ["attack 'bias': on"]),
        (SMALL.replace('on = "b"', "on = 3"), ["attack number 1 on"]),
        (SMALL.replace('on = "b"', "on = {}"), ["attack number 1 on", "one of drawn"]),
        (
            SMALL.replace('on = "b"', "on = { drawn = 1, redrawn = 1 }"),
            ["attack number 1 on", "one of drawn"],
        ),
        (SMALL.replace('on = "b"', "on = { switching = 1 }"), ["attack number 1 on", "switching with every"]),
        (SMALL.replace('on = "b"', "on = { drawn = 1, every = 2 }"), ["on", "switching with every"]),
        (SMALL.replace('on = "b"', "on = { drawn = 6 }"), ["five: bias, 6 fixed", "count", "at most 5"]),
        (SMALL.replace('on = "b"', "on = { drawn = [3, 1] }"), ["attack 'bias': on: count"]),
        (SMALL.replace('on = "b"', "on = { drawn = [true, 2] }"), ["attack number 1 on"]),
        (SMALL.replace('on = "b"', "on = { drown = 1 }"), ["attack number 1 on"]),
        (SMALL.replace('on = "b"', 'on = { drawn = 1, among = ["z"] }'), ["five: bias", "among", "'z'"]),
        (SMALL.replace("size = 5.0", ""), ["attack 'bias': size", "received nothing"]),
        (SMALL.replace("size = 5.0", 'size = "5"'), ["attack 'bias': size", "text"]),
        (SMALL.replace("size = 5.0", "size = { a = 1 }"), ["attack 'bias': size"]),
        (SMALL.replace("size = 5.0", "size = 2026-01-01"), ["attack 'bias': size"]),
        (SMALL.replace("size = 5.0", "size = nan"), ["attack 'bias': size", "finite"]),
        (SMALL.replace("size = 5.0", "size = 5.0\nunit = 3"), ["attack 'bias': unit", "'noise'"]),
        (
            SMALL.replace("size = 5.0", "size = 5.0\nslope = 3"),
            ["attack 'bias': slope", "size, unit, signs, on, start"],
        ),
        (SMALL + 'start = "5"', ["attack number 1 start", "'5'"]),
        (SMALL + "start = -1", ["attack number 1 start", "-1"]),
        (SMALL + "start = true", ["attack number 1 start", "True"]),
        (SMALL + "stop = 2", ["attack 'bias': stop"]),
        (with_lines(*ATTACK), ["attack 'x'", "either kind or parts", "neither"]),
        (with_lines(*ATTACK, 'kind = "bias"', PARTS), ["attack 'x'", "either kind or parts", "both"]),
        (with_lines(*ATTACK, 'kind = ""', PARTS), ["attack 'x'", "either kind or parts", "both"]),
        (with_lines(*ATTACK, 'kind = "none"', "size = 1"), ["attack 'x': size", "nobody lies"]),
        (with_lines(*ATTACK, 'kind = "none"', 'on = "b"'), ["attack 'x': on", "nobody lies"]),
        (with_lines(*ATTACK, "parts = []"), ["attack number 2 parts"]),
        (with_lines(*ATTACK, 'parts = [{ kind = "denial", on = "a" }]', "start = 3"), ["attack 'x': start"]),
        (with_lines(*ATTACK, 'parts = [{ kind = "denial", on = "a", size = 1 }]'), ["attack 'x': size"]),
        (with_lines(*ATTACK, "parts = [{ on = 'a' }]"), ["attack number 2 parts number 1 kind"]),
        (with_lines(*ATTACK, "parts = [{ kind = 'none', on = 'a' }]"), ["attack 'x': kind", "'none'"]),
        (with_lines(*SCENARIO, 'attacks_ = "x"'), ["scenario number 1 attacks_"]),
        (with_lines("[[scenario]]", 'plant = "six"', 'attacks = ["bias"]'), ["scenario: plant", "'six'"]),
        (
            with_lines("[[scenario]]", 'plant = "five"', 'attacks = ["x"]'),
            ["scenario of 'five': attacks", "'x'"],
        ),
        (with_lines("[[scenario]]", 'plant = "five"', "attacks = []"), ["scenario number 1 attacks"]),
        (with_lines(*SCENARIO, "prior_variance = 0.0"), ["scenario number 1 prior_variance"]),
        (with_lines(*SCENARIO, "prior_variance = inf"), ["scenario number 1 prior_variance"]),
        (with_lines(*SCENARIO, 'prior_variance = "1"'), ["scenario number 1 prior_variance"]),
        (with_lines(*SCENARIO, *SCENARIO), ["scenarios", "five: bias, on b"]),
        (with_lines("[[estimator]]", 'method = "magic"'), ["estimator: method", "'magic'"]),
        (with_lines("[[estimator]]", 'name = "x"'), ["estimator number 1 method"]),
        (
            with_lines("[[estimator]]", 'method = "kalman"', "gamma = 1"),
            ["estimator 'kalman': gamma", "none"],
        ),
        (with_lines("[[estimator]]", 'method = "sparse"', "gamma = -1"), ["estimator 'sparse': gamma"]),
        (
            with_lines("[[estimator]]", 'method = "sparse"', 'kalman_probability = ""'),
            ["estimator 'sparse': kalman_probability", "real numbers"],
        ),
        (with_lines("[[estimator]]", 'method = "sparse"', 'refit = "yes"'), ["estimator 'sparse': refit"]),
        (
            with_lines("[[estimator]]", 'method = "kalman"', 'name = "oracle"'),
            ["[[estimator]] name", "oracle"],
        ),
        (with_lines(*["[[estimator]]", 'method = "kalman"'] * 2), ["[[estimator]] name", "'kalman' twice"]),
        (SMALL + "[[[", ["a readable TOML file"]),
        (SMALL + "x = " + "[" * 5000, ["a readable TOML file"]),
        (SMALL + "start = " + "9" * 5000, ["a readable TOML file"]),
        ("", ["suite", "received nothing"]),
    ],
)
def test_a_mistake_is_named_by_file_table_and_key(folder: Path, text: str, words: list[str]) -> None:
    path = written(folder, text)
    with pytest.raises(ss.InputError) as caught:
        load_suite(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    assert [word for word in words if word not in message] == [], message


def test_a_suite_that_is_no_file_or_no_text_is_named(folder: Path) -> None:
    (folder / "binary.toml").write_bytes(b"\xff\xfe")
    for name in ("none.toml", "binary.toml", "."):
        with pytest.raises(ss.InputError, match=r"suite: expected a readable TOML file"):
            load_suite(folder / name)


@pytest.mark.parametrize("runs", [0, -1, 1.5, True])
def test_the_number_of_runs_asked_for_is_checked_as_such(folder: Path, runs: object) -> None:
    with pytest.raises(ss.InputError, match=r"^runs: expected a whole number >= 1"):
        load_suite(written(folder, SMALL), runs=runs)  # type: ignore[arg-type]


SPLICES = [
    "",
    "[",
    "]",
    "[[",
    "{",
    "}",
    "=",
    '"',
    "'",
    "\n",
    "#",
    ",",
    "-",
    ".",
    "0",
    "9e9",
    "nan",
    "true",
    "[]",
]
SPLICES += [
    "{}",
    "on",
    "kind",
    "parts",
    "none",
    "x = 1\n",
    "2026-01-01",
    "\0",
    "é",
    "\\u0000",
    '"five"',
    "[1, 6]",
]
ODD: list[Any] = [
    0,
    -1,
    3,
    10**30,
    1.5,
    float("nan"),
    float("inf"),
    True,
    "",
    "b",
    "five",
    "bias",
    "none",
    [],
    {},
]
ODD += [[1, 6], ["a"], [[]], [{}], {"drawn": 1}, {"kind": "bias"}, [{"kind": "denial", "on": "a"}], "a\0b"]


def loads_or_refuses(path: Path) -> None:
    try:
        loaded = load_suite(path)
    except ss.InputError as refusal:  # PlantError is one
        assert str(path) in str(refusal)
    else:
        assert loaded.scenarios
        assert loaded.recipes
        assert all(len(one.key) == 64 and one.stable for one in [*loaded.scenarios, *loaded.recipes])


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_text_is_a_valid_suite_or_an_input_error(folder: Path, data: st.DataObject) -> None:
    text = documented(folder).read_text()
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(text)))
        text = text[:at] + data.draw(st.sampled_from(SPLICES)) + text[at + data.draw(st.integers(0, 8)) :]
    loads_or_refuses(written(folder, text))


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_odd_values_in_odd_places_are_a_valid_suite_or_an_input_error(
    folder: Path, data: st.DataObject
) -> None:
    tables = tomllib.loads(documented(folder).read_text())
    for _ in range(data.draw(st.integers(1, 3))):
        place: Any = tables
        while True:
            keys = list(place) if isinstance(place, dict) else list(range(len(place)))
            key = data.draw(st.sampled_from(keys)) if keys else None
            if key is None or not isinstance(place[key], dict | list) or data.draw(st.booleans()):
                break
            place = place[key]
        value = copy.deepcopy(data.draw(st.sampled_from(ODD)))
        if isinstance(place, list):
            place.append(value)
        elif key is None or data.draw(st.booleans()):
            place[data.draw(st.sampled_from(["on", "start", "size", "gamma", "name", "x", "label"]))] = value
        else:
            place[key] = value
    loads_or_refuses(written(folder, tomli_w.dumps(tables)))


def test_the_arena_loads_with_names_that_differ() -> None:
    loaded = load_suite(ARENA)
    names = [one.name for one in loaded.scenarios]
    assert len(set(names)) == len(names)
    assert len({one.key for one in loaded.scenarios}) == len(names)
    assert {recipe.name for recipe in loaded.recipes} == set(METHODS)
    assert {one.plant_name for one in loaded.scenarios} >= {"IEEE-14", "Tennessee Eastman"}


KINDS: dict[str, type[SingleAttack]] = {
    "25pt": NoiseLinear,
    "26": Reflection,
    "26c": Reflection,
    "26f": DefenderReflection,
    "bias": Bias,
    "ramp": Ramp,
    "sine": Sinusoid,
    "alt": Sinusoid,
    "impulse": Pulse,
    "noise": RandomNoise,
    "drift": RandomWalk,
    "freeze": Freeze,
    "replay": Delay,
    "coordsd": FakeState,
    "coordramp": FakeState,
    "sinc": FakeState,
}
#: What else tells adversaries of one class apart, and the argument that holds their number.
DETAILS: dict[str, tuple[str, dict[str, object]]] = {
    "26": ("", {"about": "local"}),
    "26c": ("", {"about": "clean-local"}),
    "bias": ("size", {"unit": "sensor", "signs": "fixed"}),
    "ramp": ("slope", {"unit": "sensor", "limit": None}),
    "sine": ("amplitude", {"period": 12.0, "phase": 0.0}),
    "alt": ("amplitude", {"period": 2.0, "phase": 90.0}),
    "impulse": ("size", {"probability": 0.1, "width": 1}),
    "noise": ("std", {"unit": "sensor", "distribution": "gaussian"}),
    "drift": ("std", {}),
    "replay": ("samples", {}),
    "coordsd": ("shift", {"along": "prior", "profile": "constant"}),
    "coordramp": ("shift", {"along": "states", "profile": "ramp"}),
    "sinc": ("shift", {"along": "states", "profile": "sinusoid", "period": 25.0}),
}
PLANTS = {
    "scalar": "scalar",
    "partial4": "planar, partial",
    "full4": "planar, full",
    "liu": "Liu",
    "chen": "four-bus",
}


def is_counterpart(one: Scenario, cell: dict[str, Any]) -> bool:
    """Whether a scenario lets the same adversary of the same size at as many sensors of the same plant."""
    cold, name = cell["plant"].startswith("cold "), cell["plant"].removeprefix("cold ")
    if one.plant_name != PLANTS[name] or cold != (one.prior is not None):
        return False
    kind, _, size = cell["attack"].partition(":")
    if kind == "none":
        return one.attack is None
    attack, (argument, details) = one.attack, DETAILS.get(kind, ("", {}))
    if not isinstance(attack, KINDS[kind]) or attack.start != (0 if cold else one.score_from):
        return False
    wanted = details | ({argument: float(size)} if argument else {})
    count = tuple(cell["count"]) if isinstance(cell["count"], list) else cell["count"]
    on = Drawn(count) if cell["mode"] == "fixed" else Redrawn(count)
    return attack.on == on and all(getattr(attack, key) == value for key, value in wanted.items())


def test_the_arena_has_every_cell_of_the_first_benchmark() -> None:
    loaded = load_suite(ARENA)
    cells = json.loads(CELLS.read_text())
    assert len(cells) == 86
    missing = [cell for cell in cells if not any(is_counterpart(one, cell) for one in loaded.scenarios)]
    assert missing == []


def test_every_scenario_of_the_arena_can_be_simulated() -> None:
    for one in load_suite(ARENA, runs=1).scenarios:
        plant = one.plant_of(0)
        assert isinstance(plant, Plant)
        trajectory = ss.simulate(plant, one.steps, one.attack, seed=1, prior=one.prior)
        assert trajectory.attacked.any() == (one.attack is not None)

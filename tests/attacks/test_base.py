"""What all adversaries share: they add up, know what their type says, and are compared by content."""

import pickle
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from securestate import InputError, Plant, Sensor, attacks, simulate
from securestate.attacks import (
    ATTACKS,
    Bias,
    DefenderReflection,
    Delay,
    Denial,
    Drawn,
    FakeState,
    Freeze,
    Knowledge,
    NoiseLinear,
    Pulse,
    Ramp,
    RandomNoise,
    RandomWalk,
    Redrawn,
    Reflection,
    Replay,
    Scale,
    Sinusoid,
    WorstCase,
    ZeroDynamics,
)
from securestate.attacks.base import Attack, SensorAttack, SingleAttack
from tests.attacks.scenes import injected, many, scene, vehicle

EVERY: list[SingleAttack] = [
    Bias([1.0, 2.0, 3.0, 4.0, 5.0], signs="random", on="x", start=5),
    DefenderReflection(on="x", start=5),
    Delay(3, on="x", start=5),
    Denial(0.5, on="x", start=5),
    FakeState(1.0, "sinusoid", period=7, on="x", start=5),
    Freeze(on="x", start=5),
    NoiseLinear(on="x", start=5),
    Pulse(1.0, probability=0.3, on="x", start=5),
    Ramp(0.1, limit=1.0, on="x", start=5),
    RandomNoise(covariance=np.eye(5).tolist(), on="x", start=5),
    RandomWalk(1.0, on="x", start=5),
    Reflection(on="x", start=5),
    Replay(5, on="x", start=5),
    Scale(0.5, about=[1.0, 2.0, 3.0, 4.0, 5.0], on="x", start=5),
    Sinusoid(1.0, period=2, phase=90, on="x", start=5),
    WorstCase(2.0, on="x", start=5),
    ZeroDynamics(on="x", start=5),
]
STAGED = [attack for attack in EVERY if not isinstance(attack, ZeroDynamics)]
name_of = lambda attack: type(attack).__name__  # noqa: E731


def test_the_registry_holds_every_adversary_once_under_its_name_in_kebab_case() -> None:
    public = {name for name in attacks.__all__ if is_adversary(getattr(attacks, name))}
    kebab = {"".join(f"-{c.lower()}" if c.isupper() else c for c in name)[1:] for name in public}
    assert set(ATTACKS) == kebab
    assert {kind.__name__ for kind in ATTACKS.values()} == public
    assert sorted(map(name_of, EVERY)) == sorted(public)
    assert list(attacks.__all__) == sorted(attacks.__all__)


def is_adversary(thing: object) -> bool:
    return isinstance(thing, type) and issubclass(thing, SingleAttack)


@pytest.mark.parametrize("attack", EVERY, ids=name_of)
def test_an_adversary_is_a_value(attack: SingleAttack) -> None:
    again = pickle.loads(pickle.dumps(attack))
    assert again == attack == eval(repr(attack), vars(attacks))
    assert hash(again) == hash(attack)
    assert replace(attack, start=6) != attack


@pytest.mark.parametrize("attack", STAGED, ids=name_of)
def test_nothing_is_injected_before_the_start_after_the_stop_and_elsewhere(attack: SingleAttack) -> None:
    staged = replace(attack, stop=20).stage(scene(vehicle()))
    expected = np.zeros((3, 40, 4), dtype=bool)
    expected[:, 5:20, 0] = True
    np.testing.assert_array_equal(staged.attacked, expected)
    assert np.all(staged.a[:, :5] == 0)
    assert np.all(staged.a[:, 20:] == 0)
    assert np.all(staged.a[:, :, 1:] == 0)


@pytest.mark.parametrize("attack", STAGED, ids=name_of)
def test_a_run_has_the_same_bits_in_any_batch(attack: SingleAttack) -> None:
    plant = vehicle()
    if not isinstance(attack, WorstCase):
        attack = replace(attack, on=Redrawn((0, 3)))
    together, alone = attack.stage(scene(plant, runs=4)), attack.stage(scene(plant, runs=1, first=2))
    np.testing.assert_array_equal(together.a[2], alone.a[0])
    np.testing.assert_array_equal(together.attacked[2], alone.attacked[0])


@pytest.mark.parametrize("attack", STAGED, ids=name_of)
def test_an_attack_from_sample_0_or_beyond_the_end_is_fine(attack: SingleAttack) -> None:
    if not isinstance(attack, Replay):
        assert np.all(replace(attack, start=0).stage(scene(vehicle())).attacked[:, :, 0])
    assert not replace(attack, start=100).stage(scene(vehicle())).attacked.any()


@pytest.mark.parametrize("attack", [a for a in EVERY if isinstance(a, SensorAttack)], ids=name_of)
def test_a_sensor_attack_knows_its_own_sensors_only(attack: SensorAttack) -> None:
    clean = scene(vehicle())
    other = clean.y + np.array([0.0, 7.0, 7.0, 7.0, 7.0])
    changed = replace(clean, y=other, x=clean.x + 5, u=clean.u + 5, v=clean.v + 5)
    np.testing.assert_array_equal(injected(attack, clean), injected(attack, changed))
    assert attack.knows is Knowledge.OWN_SENSORS


@pytest.mark.parametrize("attack", [Reflection(on="x"), FakeState(1.0, on="x"), WorstCase(1.0, on="x")])
def test_a_plant_attack_knows_neither_state_nor_noise_nor_other_sensors(attack: SingleAttack) -> None:
    clean = scene(vehicle())
    other = clean.y + np.array([0.0, 7.0, 7.0, 7.0, 7.0])
    changed = replace(clean, y=other, x=clean.x + 5, v=clean.v + 5)
    np.testing.assert_array_equal(injected(attack, clean), injected(attack, changed))
    assert attack.knows is Knowledge.PLANT


def test_injections_add_up_and_a_missing_reading_stays_missing() -> None:
    both = Bias(2.0, on="x") + Bias([0, 3.0, 0, 0, 0], on=["y", "x"]) + Denial(on="y", start=39)
    a = injected(both, scene(vehicle()))
    assert np.all(a[:, :, 0] == 2.0)
    assert np.all(a[:, :39, 1] == 3.0)
    assert np.all(np.isnan(a[:, 39, 1]))
    assert np.all(a[:, :, 2:] == 0.0)
    assert [type(part) for part in both.parts] == [Bias, Bias, Denial]


def test_members_of_a_sum_draw_numbers_of_their_own() -> None:
    noise = RandomNoise(1.0, on="x")
    given = scene(vehicle())
    assert not np.any(injected(noise + noise, given)[:, :, 0] == 2 * injected(noise, given)[:, :, 0])


def test_the_choice_of_sensors_and_the_signal_do_not_share_random_numbers() -> None:
    attack = RandomNoise(1.0, on=Redrawn(3))
    staged = attack.stage(scene(many(), steps=2000, runs=1))
    values = staged.a[staged.attacked]
    assert abs(np.mean(values)) < 4 / np.sqrt(len(values))
    assert abs(np.std(values) - 1) < 4 / np.sqrt(2 * len(values))


def test_a_number_of_sizes_that_does_not_fit_the_plant_is_refused() -> None:
    with pytest.raises(InputError, match="size: expected one number or 5, one per channel, received 2"):
        injected(Bias([1.0, 2.0], on="x"), scene(vehicle()))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"on": "x", "start": -1}, "start: expected a whole number >= 0, received -1"),
        ({"on": "x", "start": 1.5}, "start: expected a whole number"),
        ({"on": "x", "start": 5, "stop": 5}, "stop: expected a whole number >= 6, received 5"),
        ({"on": 1.5}, "on: expected sensor names, indices, or Targets"),
        ({"on": []}, "on: expected sensor names"),
        ({"on": True}, "on: expected sensor names"),
    ],
)
def test_wrong_sensors_and_times_are_refused(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Freeze(**arguments)  # type: ignore[arg-type]


WRONG = [
    (Bias, {"size": np.inf}, "size: expected finite numbers"),
    (Bias, {"size": "2"}, "size: expected an array of real numbers"),
    (Bias, {"size": [[1.0]]}, "size: expected one number, or one per channel"),
    (Bias, {"size": 1.0, "unit": "volt"}, "unit: expected 'sensor' or 'noise', received 'volt'"),
    (Bias, {"size": 1.0, "signs": None}, "signs: expected 'fixed' or 'random', received None"),
    (Delay, {"samples": 0}, "samples: expected a whole number >= 1"),
    (Denial, {"probability": 1.1}, r"probability: expected a probability in \[0, 1\]"),
    (FakeState, {"shift": np.nan}, "shift: expected finite numbers"),
    (FakeState, {"shift": [1.0, 2.0], "along": "prior"}, "shift: expected one number"),
    (FakeState, {"shift": 1.0, "profile": "sinusoid"}, "period: expected an array of real numbers"),
    (FakeState, {"shift": 1.0, "period": 3.0}, "period: expected None, because only a sinusoid has one"),
    (FakeState, {"shift": 1.0, "profile": "step"}, "profile: expected 'constant' or 'ramp' or 'sinusoid'"),
    (NoiseLinear, {"beta": (1.0, -1.0)}, r"beta: expected a pair \(low, high\) with low <= high"),
    (NoiseLinear, {"theta": 1.0}, r"theta: expected a pair \(low, high\)"),
    (NoiseLinear, {"redraw": "never"}, "redraw: expected 'sample' or 'sensor' or 'run'"),
    (Pulse, {"size": 1.0, "every": 2, "width": 3}, "every: expected a whole number >= 3"),
    (Pulse, {"size": 1.0, "every": 2, "probability": 0.5}, "probability: expected None"),
    (Pulse, {"size": 1.0, "probability": -0.5}, "probability: expected a probability"),
    (Pulse, {"size": 1.0, "width": 0}, "width: expected a whole number >= 1"),
    (Ramp, {"slope": 1.0, "limit": 0.0}, "limit: expected one number > 0"),
    (RandomNoise, {}, "std: expected either std or covariance, received neither"),
    (
        RandomNoise,
        {"std": 1.0, "covariance": [[1.0]]},
        "std: expected either std or covariance, received both",
    ),
    (RandomNoise, {"std": -1.0}, "std: expected numbers >= 0"),
    (RandomNoise, {"covariance": [[1.0, 2.0], [2.0, 1.0]]}, "covariance: expected a positive semidefinite"),
    (RandomNoise, {"covariance": [1.0]}, "covariance: expected a square matrix"),
    (RandomNoise, {"std": 1.0, "distribution": "uniform"}, "distribution: expected 'gaussian' or 'laplace'"),
    (RandomWalk, {"std": -1.0}, "std: expected numbers >= 0"),
    (Reflection, {"about": "defender"}, "about: expected 'local' or 'clean-local'"),
    (Replay, {"length": 1}, "start: expected at least 1, the samples to record, received 0"),
    (Scale, {"factor": None}, "factor: expected an array of real numbers"),
    (Sinusoid, {"amplitude": 1.0, "period": 0.0}, "period: expected one number > 0"),
    (Sinusoid, {"amplitude": 1.0, "period": 5.0, "phase": np.inf}, "phase: expected finite numbers"),
    (WorstCase, {"size": 0.0}, "size: expected one number > 0"),
    (WorstCase, {"size": 1.0, "on": Drawn(1)}, "on: expected named sensors, the same at all times"),
    (ZeroDynamics, {"size": -1.0}, "size: expected one number > 0"),
    (ZeroDynamics, {"on": Redrawn(1)}, "on: expected named sensors, the same at all times"),
]


@pytest.mark.parametrize(("kind", "arguments", "message"), WRONG)
def test_a_wrong_argument_is_refused_by_name(
    kind: type[Attack], arguments: dict[str, object], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        kind(**({"on": "x"} | arguments))


@dataclass(frozen=True)
class Odd(SensorAttack):
    """Injects whatever it is given."""

    what: object = 0.0

    def inject(self, view: object) -> Any:
        return self.what


@pytest.mark.parametrize(
    ("what", "message"),
    [
        ((1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0), "injection of Odd: expected numbers of shape"),
        ("text", "injection of Odd: expected numbers of shape"),
        (float("inf"), "injection of Odd: expected finite numbers, or NaN to suppress a reading"),
    ],
)
def test_an_injection_that_does_not_fit_is_named(what: object, message: str) -> None:
    plant = Plant([[0.9]], [[1.0]], [Sensor("a", C=[1.0], R=1.0), Sensor("b", C=[1.0], R=1.0)])
    with pytest.raises(InputError, match=message):
        simulate(plant, 5, Odd(what=what, on="a"), seed=1)

"""Attack (26) and its variants against plain loops."""

import numpy as np
import pytest

from securestate import DesignError, Plant, Sensor
from securestate._local_filters import local_filters
from securestate.attacks import DefenderReflection, Redrawn, Reflection
from securestate.attacks.knowledge import Scene
from tests.attacks.scenes import Float, injected, many, scene, vehicle


def looped(given: Scene, attacked: np.ndarray, about: str) -> Float:
    """(26), one run, one sensor and one sample after the other."""
    plant, a = given.plant, np.zeros_like(given.y)
    for run in range(len(given.y)):
        for i, own in enumerate(local_filters(plant)):
            rows, z = plant.channels_of(i), np.zeros(len(own.A))
            for k in range(given.y.shape[1]):
                ut = (given.u[run, k] - plant.input_offset) / plant.input_scale
                expected = own.C @ z + own.D @ ut
                y = (given.y[run, k, rows] - plant.offset[rows]) / plant.scale[rows]
                sent = y
                if attacked[run, k, i]:
                    sent = y - 2 * (y - expected)
                    a[run, k, rows] = plant.scale[rows] * (sent - y)
                heard = sent if about == "local" else y
                z = own.A @ (z + own.gain @ (heard - expected)) + own.B @ ut
    return a


@pytest.mark.parametrize("about", ["local", "clean-local"])
@pytest.mark.parametrize("plant", [vehicle(), many()], ids=["vehicle", "many"])
def test_the_lie_mirrors_the_reading_about_what_the_sensors_own_filter_expects(
    plant: Plant, about: str
) -> None:
    given = scene(plant, steps=30)
    staged = Reflection(about, on=Redrawn((0, 3)), start=4).stage(given)  # type: ignore[arg-type]
    expected = looped(given, staged.attacked, about)
    np.testing.assert_allclose(staged.a, expected, rtol=1e-9, atol=1e-9)


def test_on_a_fixed_set_the_contaminated_lie_grows_and_stays_finite() -> None:
    given = scene(vehicle(), steps=3000, runs=2)
    fixed = injected(Reflection("local", on=["x", "gps"]), given)
    largest = np.abs(fixed).max(axis=(0, 1))
    np.testing.assert_allclose(largest[0], 2 * 2.0 * 1e100, rtol=1e-12)
    assert np.all(np.isfinite(fixed))
    clean = injected(Reflection("clean-local", on=["x", "gps"]), given)
    assert np.abs(clean).max() < 100


def test_an_unstable_plant_keeps_the_contaminated_lie_finite() -> None:
    plant = Plant([[2.0]], [[1.0]], [Sensor("a", C=[1.0], R=1.0)])
    given = scene(plant, steps=3)
    x, u, v, y = (np.repeat(each, 1000, axis=1) for each in (given.x, given.u, given.v, given.y))
    long = Scene(plant, x, u, v, y, given.rngs)
    assert np.all(np.isfinite(injected(Reflection(on="a"), long)))


def test_only_attacked_sensors_need_a_filter_of_their_own() -> None:
    sensors = [Sensor("a", C=[1, 0], R=1), Sensor("b", C=[0, 1], R=1)]
    plant = Plant(np.diag([1.0, 0.5]), np.diag([0.0, 1.0]), sensors)
    assert np.any(injected(Reflection(on="b"), scene(plant)))
    with pytest.raises(DesignError, match="sensor 'a' has no steady-state filter of its own"):
        injected(Reflection(on="a"), scene(plant))


def test_the_defenders_expectation_is_mirrored_while_it_happens() -> None:
    given = scene(vehicle())
    staged = DefenderReflection(on=["y", "gps"], start=10).stage(given)
    assert np.all(staged.a == 0)
    (reaction,) = staged.reactions
    expected = np.full((3, 5), 0.25)
    now = reaction(12, expected)
    np.testing.assert_allclose(now[:, 1:4], -2 * (given.y[:, 12, 1:4] - 0.25))
    assert np.all(now[:, [0, 4]] == 0)
    assert np.all(reaction(9, expected) == 0)

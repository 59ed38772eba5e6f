"""Trajectories: what the equations say, whatever the batch."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from securestate import (
    Belief,
    DesignError,
    InnovationGate,
    InputError,
    KalmanFilter,
    OracleFilter,
    Plant,
    Sensor,
    ShapeError,
)
from securestate.attacks import Bias, DefenderReflection, Denial, Drawn, RandomNoise, Redrawn
from securestate.attacks.base import ClosedLoopAttack
from securestate.simulation import Simulator, Trajectory, simulate, stabilised


def engineering(**changes: Any) -> Plant:
    """A plant with inputs, feedthrough, correlated noise, a vector sensor and an operating point."""
    sensors = [
        Sensor("pair", C=[[1.0, 0.0], [1.0, 1.0]], offset=[100.0, -3.0], scale=[2.0, 0.5]),
        Sensor("single", C=[0.0, 1.0], offset=7.0, scale=10.0),
        Sensor("safe", C=[1.0, -1.0], protected=True),
    ]
    given: dict[str, Any] = {
        "A": [[0.9, 0.2], [-0.1, 0.8]],
        "Q": [[0.5, 0.2], [0.2, 0.4]],
        "B": [[1.0], [0.5]],
        "D": [[0.1], [0.0], [0.3], [0.0]],
        "R": [[1.0, 0.3, 0.1, 0.0], [0.3, 1.0, 0.0, 0.0], [0.1, 0.0, 2.0, 0.5], [0.0, 0.0, 0.5, 1.0]],
        "input_offset": 50.0,
        "input_scale": 4.0,
    } | changes
    return Plant(given.pop("A"), given.pop("Q"), sensors, **given)


def noises(trajectory: Trajectory) -> tuple[Any, Any]:
    """W (runs, T − 1, n) and v (runs, T, m) from states, inputs and clean readings, normalised units."""
    plant = trajectory.plant
    w = trajectory.x[:, 1:] - plant.successor(trajectory.x, trajectory.u)[:, :-1]
    return w, (trajectory.clean - plant.reading(trajectory.x, trajectory.u)) / plant.scale


def covariance_error(samples: Any, expected: Any) -> float:
    """Largest error of the sample covariance, in units of its own standard error."""
    flat = samples.reshape(-1, samples.shape[-1])
    found = flat.T @ flat / len(flat)
    variance = np.outer(np.diag(expected), np.diag(expected)) + expected**2
    return float((np.abs(found - expected) / np.sqrt(variance / len(flat))).max())


def test_noises_have_the_covariances_of_the_plant_and_are_independent() -> None:
    plant = engineering()
    trajectory = simulate(plant, 200, runs=200, seed=4, u=np.linspace(40.0, 60.0, 200)[:, np.newaxis])
    w, v = noises(trajectory)
    joint = np.zeros((6, 6))
    joint[:2, :2], joint[2:, 2:] = plant.Q, plant.R
    assert covariance_error(np.concatenate([w, v[:, :-1]], axis=-1), joint) < 4.5
    lag = np.zeros((12, 12))
    lag[:6, :6] = lag[6:, 6:] = joint
    both = np.concatenate([w, v[:, :-1]], axis=-1)
    assert covariance_error(np.concatenate([both[:, :-1], both[:, 1:]], axis=-1), lag) < 5


def test_the_first_state_has_the_steady_prediction_covariance() -> None:
    plant = engineering()
    steady = KalmanFilter(plant).steady
    assert steady is not None
    x = simulate(plant, 1, runs=20_000, seed=5).x[:, 0]
    assert covariance_error(x, steady.P_prior) < 4.5


def test_a_prior_says_where_the_state_starts() -> None:
    P = np.array([[4.0, 1.0], [1.0, 2.0]])
    x = simulate(engineering(), 1, runs=20_000, seed=5, prior=Belief([10.0, -20.0], P)).x[:, 0]
    assert covariance_error(x - [10.0, -20.0], P) < 4.5


def test_a_run_is_the_same_in_any_batch() -> None:
    attack = RandomNoise(3.0, on=Redrawn((0, 2)), start=5) + Bias(1.0, on=Drawn(1))
    whole = simulate(engineering(), 60, attack, runs=12, seed=9)
    part = simulate(engineering(), 60, attack, runs=3, seed=9, first_run=7)
    for name in ("x", "u", "clean", "y", "a", "attacked"):
        np.testing.assert_array_equal(getattr(part, name), getattr(whole, name)[7:10])
    assert not np.array_equal(whole.x[0], whole.x[1])


def test_a_longer_run_begins_like_a_shorter_one() -> None:
    short, long = (simulate(engineering(), steps, runs=3, seed=2) for steps in (30, 90))
    np.testing.assert_array_equal(long.clean[:, :30], short.clean)


def test_an_attack_does_not_change_what_the_sensors_measure() -> None:
    honest = simulate(engineering(), 50, runs=4, seed=6)
    attacked = simulate(engineering(), 50, RandomNoise(5.0, on=Drawn(2)), runs=4, seed=6)
    np.testing.assert_array_equal(attacked.x, honest.x)
    np.testing.assert_array_equal(attacked.clean, honest.clean)
    np.testing.assert_array_equal(attacked.y, attacked.clean + attacked.a)
    assert not honest.attacked.any()
    assert not attacked.attacked[..., 2].any()  # protected


def test_a_generator_gives_one_seed() -> None:
    first, again, next_one = (
        simulate(engineering(), 5, seed=rng)
        for rng in (np.random.default_rng(1), np.random.default_rng(1), np.random.default_rng(2))
    )
    np.testing.assert_array_equal(first.x, again.x)
    assert not np.array_equal(first.x, next_one.x)


def test_a_and_c_may_vary_in_time() -> None:
    rng = np.random.default_rng(3)
    A, C = rng.normal(size=(40, 2, 2)) / 2, rng.normal(size=(40, 1, 2))
    plant = Plant(A, np.eye(2) * 1e-18, [Sensor("a", C=C, R=1e-18)])
    trajectory = simulate(plant, 40, seed=1, prior=Belief([1.0, 2.0], np.eye(2) * 1e-18))
    x = np.array([1.0, 2.0])
    for k in range(40):
        np.testing.assert_allclose(trajectory.clean[0, k], C[k] @ x, atol=1e-7)
        x = A[k] @ x
    with pytest.raises(InputError, match="steps: expected at most 40"):
        simulate(plant, 41, seed=1, prior=Belief([1.0, 2.0], np.eye(2)))


def test_suppressed_readings_are_missing() -> None:
    trajectory = simulate(engineering(), 20, Denial(on="pair", start=5, stop=8), runs=2, seed=1)
    missing = np.isnan(trajectory.y)
    assert missing[:, 5:8, :2].all()
    assert missing.sum() == 2 * 3 * 2
    run, _ = trajectory.confront(KalmanFilter(trajectory.plant))
    assert np.isnan(run.trust[:, 5:8, 0]).all()


@dataclass(frozen=True)
class Mirror(ClosedLoopAttack):
    """What DefenderReflection does, without telling that it is proportional."""

    def react(self, view: Any, k: int, expected: Any) -> Any:
        return 2.0 * (expected - view.y[:, k])


@pytest.mark.parametrize("adversary", [DefenderReflection, Mirror])
@pytest.mark.parametrize("make", [KalmanFilter, InnovationGate])
def test_a_closed_loop_reacts_to_what_the_filter_really_expects(make: Any, adversary: Any) -> None:
    plant = engineering()
    attack = adversary(on=Redrawn((0, 2)), start=3) + Bias(2.0, on="single", start=10)
    trajectory = simulate(plant, 40, attack, runs=5, seed=8, u=np.full((40, 1), 55.0))
    estimator = make(plant)
    run, met = trajectory.confront(estimator)
    alone = estimator.run(met.y, met.u)
    for name in ("x", "P", "innovation", "suspected", "trust", "status"):
        np.testing.assert_array_equal(getattr(run, name), getattr(alone, name))
    expected = met.y - run.innovation
    bias = np.zeros((40, 4))
    bias[10:, 2] = 2.0
    reflected = trajectory.reactions[0].view.attacked[..., plant.channel_sensor]
    promised = np.where(reflected, 2 * expected - met.clean, met.clean) + bias
    np.testing.assert_allclose(met.y, promised, atol=1e-9)
    assert met.reactions == ()


def test_who_reacts_in_proportion_does_the_same_in_the_kernels_as_step_by_step() -> None:
    plant = engineering()
    prior = Belief([1.0, -2.0], np.diag([5.0, 7.0]))
    for make in (KalmanFilter, InnovationGate, OracleFilter):
        met = []
        for adversary in (DefenderReflection, Mirror):
            attack = adversary(on=Redrawn((0, 2))) + Denial(0.3, on=Drawn(1))
            trajectory = simulate(plant, 40, attack, runs=4, seed=6, prior=prior)
            met.append(trajectory.confront(make(plant)))
        np.testing.assert_allclose(met[0][0].x, met[1][0].x, atol=1e-9)
        np.testing.assert_allclose(met[0][1].y, met[1][1].y, atol=1e-8)
        np.testing.assert_allclose(met[0][1].a, met[1][1].a, atol=1e-8)


def test_a_closed_loop_is_the_same_in_any_batch() -> None:
    plant = engineering()
    runs = []
    for first, count in ((0, 12), (5, 3)):
        trajectory = simulate(
            plant, 50, DefenderReflection(on=Redrawn(2)), runs=count, seed=4, first_run=first
        )
        runs.append(trajectory.confront(InnovationGate(plant))[0])
    np.testing.assert_array_equal(runs[1].x, runs[0].x[5:8])


def test_the_oracle_is_not_moved_by_a_closed_loop() -> None:
    plant = engineering()
    trajectory = simulate(plant, 30, DefenderReflection(on=Redrawn(2)), runs=3, seed=8)
    run, met = trajectory.confront(OracleFilter(plant))
    without = np.where(met.attacked[..., plant.channel_sensor], np.nan, met.clean)
    np.testing.assert_allclose(run.x, KalmanFilter(plant).run(without, met.u).x, atol=1e-12)


def test_a_first_sample_can_be_attacked_under_a_diffuse_prior() -> None:
    plant = engineering()
    prior = Belief(np.zeros(2), 1e6 * np.eye(2))
    trajectory = simulate(plant, 5, Bias(1e4, on="pair"), runs=2, seed=3, prior=prior)
    assert trajectory.attacked[:, 0, 0].all()
    run, _ = trajectory.confront(KalmanFilter(plant))
    assert np.abs(run.x[:, 0] - trajectory.x[:, 0]).max() > 100


def unstable(with_input: bool) -> Plant:
    sensors = [Sensor(name, C=C, R=1.0) for name, C in {"a": [1.0, 0.5], "b": [0.3, 1.0]}.items()]
    return Plant(np.diag([-2.0, 0.5]), np.eye(2), sensors, B=[[1.0], [0.0]] if with_input else None)


def test_an_unstable_plant_with_inputs_stays_bounded_and_keeps_its_errors() -> None:
    plant = unstable(with_input=True)
    trajectory = simulate(plant, 400, runs=50, seed=1)
    assert np.abs(trajectory.x).max() < 100
    w, v = noises(trajectory)
    assert covariance_error(w, plant.Q) < 4.5
    assert covariance_error(v, plant.R) < 4.5
    run, _ = trajectory.confront(KalmanFilter(plant))
    assert run.P is not None
    assert covariance_error((run.x - trajectory.x)[:, 50::10], run.P[0, -1]) < 5


def test_an_unstable_plant_without_inputs_is_refused_where_digits_would_run_out() -> None:
    plant = unstable(with_input=False)
    assert np.isfinite(simulate(plant, 15, seed=1).x).all()
    with pytest.raises(DesignError, match=r"within 100 samples the state grows 2\^100 times.*stabilised"):
        simulate(plant, 100, seed=1)


def test_stabilised_adds_inputs_only_where_they_are_needed() -> None:
    plain = unstable(with_input=False)
    held = stabilised(plain)
    assert held.input_names == ("stabilising x1", "stabilising x2")
    np.testing.assert_array_equal(held.A, plain.A)
    assert np.abs(simulate(held, 300, runs=3, seed=1).x).max() < 100
    assert stabilised(unstable(with_input=True)).n_inputs == 1
    assert stabilised(engineering()) == engineering()
    correlated = Plant(
        np.diag([-2.0, 0.5, 0.1]),
        np.eye(3),
        [Sensor("a", C=np.eye(3), offset=3.0, scale=2.0, unit="m", protected=True, verifiable=False)],
        R=np.eye(3) + 0.1,
        B=[[0.0], [1.0], [0.0]],
        D=[[1.0], [2.0], [3.0]],
        input_scale=5.0,
    )
    kept = stabilised(correlated)
    np.testing.assert_array_equal(kept.R, correlated.R)
    np.testing.assert_array_equal(kept.D[:, 0], [1.0, 2.0, 3.0])
    assert (kept.n_inputs, kept.units, bool(kept.protected[0])) == (4, ("m", "m", "m"), True)
    assert list(kept.input_scale) == [5.0, 1.0, 1.0, 1.0] and not kept.verifiable[0]


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"steps": 0}, InputError, "steps: expected a whole number >= 1, received 0"),
        ({"steps": True}, InputError, "steps: expected a whole number"),
        ({"runs": 0}, InputError, "runs: expected a whole number >= 1"),
        ({"first_run": -1}, InputError, "first_run: expected a whole number >= 0"),
        ({"seed": -1}, InputError, "seed: expected a whole number >= 0"),
        ({"attack": "bias"}, InputError, "attack: expected an Attack"),
        ({"plant": "tank.toml"}, InputError, "plant: expected a Plant"),
        (
            {"u": np.zeros((3, 1))},
            ShapeError,
            r"u: expected shape \(5, 1\) or \(1, 5, 1\)",
        ),
        ({"u": np.full((5, 1), np.nan)}, InputError, "u: expected finite numbers"),
        ({"prior": Belief([0.0])}, InputError, "prior: expected a Belief about 2 states"),
        ({"attack": Bias(1.0, on="nobody")}, InputError, "on: expected a sensor of the plant"),
        ({"attack": Bias(1.0, on="safe")}, InputError, "on: expected sensors that are not protected"),
    ],
)
def test_a_wrong_argument_is_named(arguments: dict[str, Any], error: type[Exception], message: str) -> None:
    given = {"plant": engineering(), "steps": 5, "seed": 1} | arguments
    with pytest.raises(error, match=message):
        simulate(**given)


def test_a_plant_without_steady_state_asks_for_a_prior() -> None:
    plant = Plant([[1.0]], [[0.0]], [Sensor("a", C=[1.0], R=1.0)])
    with pytest.raises(DesignError, match="give a prior with a covariance P"):
        simulate(plant, 5, seed=1)
    assert simulate(plant, 5, seed=1, prior=Belief([0.0], [[1.0]])).x.shape == (1, 5, 1)


def test_an_estimator_of_another_plant_is_refused() -> None:
    with pytest.raises(InputError, match="estimator: expected one for"):
        simulate(engineering(), 5, seed=1).confront(KalmanFilter(unstable(with_input=True)))


def test_a_simulator_gives_what_simulate_gives() -> None:
    simulator = Simulator(engineering(), 20)
    for seed in (1, 2):
        np.testing.assert_array_equal(simulator.run(seed=seed).y, simulate(engineering(), 20, seed=seed).y)

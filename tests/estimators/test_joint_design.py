"""What JointFusion refuses and warns of at design time, and its fusion rules."""

from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize

from securestate import (
    AdaptiveJointFilter,
    Belief,
    DesignError,
    InputError,
    JointFusion,
    Plant,
    SecurestateWarning,
    Sensor,
    ShapeError,
)
from tests.estimators.joint_cases import (
    PAPER_PAIRS,
    PAPER_PRIOR,
    Array,
    paper_plant,
    random_plant,
    some_prior,
)


def two_states(a: float, b: float, weak: list[float], strong: list[float]) -> Plant:
    sensors = [Sensor("weak", C=weak, R=1.0), Sensor("strong", C=strong, R=1.0, protected=True)]
    return Plant(np.diag([a, b]), np.eye(2), sensors)


def test_a_mode_that_nobody_sees_is_refused_by_sensor_and_mode() -> None:
    with pytest.raises(
        DesignError, match=r"sensor 'weak' and the protected sensors .* do not see mode 1\.1 \(x2\)"
    ):
        JointFusion(two_states(0.5, 1.1, [1, 0], [1, 0]))


def test_a_constant_injection_that_looks_like_a_mode_at_one_is_refused_by_sensor_and_mode() -> None:
    message = r"a constant injection on sensor 'weak' cannot be told from mode 1 \(x2\)"
    with pytest.raises(DesignError, match=message):
        JointFusion(two_states(0.5, 1.0, [0, 1], [1, 0]))


def test_gains_that_are_optimal_one_step_ahead_but_unstable_are_refused() -> None:
    message = r"local estimator of sensor 'weak' is unstable: .* grows by 1\.0\d* per sample"
    with pytest.warns(SecurestateWarning, match="mode 1.02"), pytest.raises(DesignError, match=message):
        JointFusion(two_states(0.9, 1.02, [0, 1], [1, 0]))


def test_an_injection_along_a_hidden_mode_is_warned_of() -> None:
    message = (
        r"sensor 'weak' is stacked with do not see mode -1 \(x2\): an injection along it stays invisible"
    )
    with pytest.warns(SecurestateWarning, match=message):
        JointFusion(two_states(0.5, -1.0, [0, 1], [1, 0]), eta=0.5)


def test_a_mode_that_fades_need_not_be_seen() -> None:
    assert JointFusion(two_states(0.9, 0.5, [1, 0], [1, 0])).no_steady_state == ""


def test_the_mode_is_looked_for_among_the_partners_of_the_sensor() -> None:
    sensors = [
        Sensor("u", C=[1.0, 0.0], R=1.0),
        Sensor("v", C=[0.0, 1.0], R=1.0),
        Sensor("p", C=[1.0, 0.0], R=1.0, protected=True),
        Sensor("q", C=[0.0, 1.0], R=1.0, protected=True),
    ]
    plant = Plant(np.diag([0.5, 1.0]), np.eye(2), sensors)
    JointFusion(plant)
    JointFusion(plant, pairing={"u": ["p", "q"], "v": ["q"]})
    with pytest.raises(
        DesignError, match="sensor 'u' and the protected sensors it is stacked with do not see mode 1"
    ):
        JointFusion(plant, pairing={"u": ["p"], "v": ["q"]})
    with pytest.raises(DesignError, match="a constant injection on sensor 'v' cannot be told from mode 1"):
        JointFusion(plant, pairing={"v": ["p"]})


@pytest.mark.parametrize("eta", [0.0, 1e-3, 1.0, 1e6, "adaptive"])
def test_the_papers_example_is_stable_for_every_eta(eta: Any) -> None:
    assert JointFusion(paper_plant(), eta=eta, pairing=PAPER_PAIRS).no_steady_state == ""


def test_plants_with_nobody_or_everybody_protected_are_refused() -> None:
    plant = paper_plant()
    everybody = Plant(plant.A, plant.Q, [Sensor(s.name, C=s.C, R=0.1, protected=True) for s in plant.sensors])
    nobody = Plant(plant.A, plant.Q, [Sensor(s.name, C=s.C, R=0.1) for s in plant.sensors])
    for settings in ({}, {"protected": "auto"}):
        with pytest.raises(
            DesignError, match="every sensor is protected, so nobody can lie; use KalmanFilter"
        ):
            JointFusion(everybody, **settings)
    with pytest.raises(DesignError, match="none is protected"):
        JointFusion(nobody)
    with pytest.raises(DesignError, match="one sensor has nobody to be stacked with"):
        JointFusion(nobody.select([0]), protected="auto")
    with pytest.raises(InputError, match="plant: expected a Plant"):
        JointFusion("plant.toml")  # type: ignore[arg-type]


BAD: list[tuple[dict[str, Any], str]] = [
    (
        {"pairing": {}},
        "pairing: expected a mapping from sensor names to names of protected sensors, received",
    ),
    ({"pairing": ["s1"]}, "pairing: expected a mapping"),
    (
        {"pairing": {"s3": ["s4"]}},
        r"pairing: expected sensors that are not protected \(s1, s2\), received 's3'",
    ),
    (
        {"pairing": {"s1": ["s2"]}},
        r"pairing\['s1'\]: expected protected sensors \(s3, s4, s5\), received 's2'",
    ),
    ({"pairing": {"s1": 5}}, r"pairing\['s1'\]: expected a list of names of protected sensors, received 5"),
    ({"pairing": {"s1": [["s3"]]}}, r"pairing\['s1'\]: expected protected sensors"),
    ({"fusion": np.array([1.0, 2.0])}, "fusion: expected"),
    ({"window": -1}, "window: expected a whole number"),
    ({"pairing": {"s1": []}}, r"pairing\['s1'\]: expected one or more different protected sensors"),
    ({"pairing": {"s1": ["s3", "s3"]}}, r"pairing\['s1'\]: expected one or more different"),
    ({"eta": -1.0}, "eta: expected finite variances >= 0, received -1"),
    ({"eta": np.inf}, "eta: expected finite numbers, received inf"),
    ({"eta": [1.0, np.nan]}, "eta: expected"),
    ({"eta": "auto"}, 'eta: expected a variance, one per sensor that may lie, or "adaptive", received'),
    ({"eta": {"s1": 1.0}}, "eta: expected a value for s1, s2, received s1"),
    ({"eta": {"s1": 1.0, "s2": "big"}}, r"eta\['s2'\]: expected a number, received 'big'"),
    ({"eta": {"s1": 1.0, "s2": -2.0}}, "eta: expected finite variances"),
    ({"form": "joseph"}, 'form: expected "exact" or "printed", received \'joseph\''),
    ({"form": "printed", "eta": "adaptive"}, 'form: expected "exact" where eta'),
    ({"form": "printed", "protected": "auto"}, 'form: expected "exact" where eta'),
    ({"form": "printed", "square_root": True}, 'square_root: expected form="exact"'),
    ({"square_root": 1}, "square_root: expected"),
    ({"fusion": "best"}, 'fusion: expected "optimal" or "average" or "covariance-intersection"'),
    ({"protected": ["s3"]}, 'protected: expected "marked" or "auto"'),
    ({"protected": "auto", "pairing": PAPER_PAIRS}, 'pairing: expected None for protected="auto"'),
    ({"protected": "auto", "eta": "adaptive"}, 'eta: expected variances for protected="auto"'),
    ({"detector": "cusum"}, 'detector: expected "gate" or "chi-square"'),
    ({"eta": "adaptive", "window": 0}, "window: expected a whole number"),
    ({"eta": "adaptive", "window": 2.5}, "window: expected a whole number"),
    (
        {"eta": "adaptive", "window": 10**13},
        "window: expected a whole number up to 10000, received 10000000000000",
    ),
    ({"eta": "adaptive", "gate": -1.0}, "gate: expected a number > 0; math.inf for none, received -1.0"),
    ({"eta": "adaptive", "gate": float("nan")}, "gate: expected a number"),
    ({"false_alarm_rate": 1.0}, r"false_alarm_rate: expected a number in \(0, 1\)"),
]


@pytest.mark.parametrize(("settings", "message"), BAD, ids=[str(settings) for settings, _ in BAD])
def test_bad_settings_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        JointFusion(paper_plant(), **settings)


@pytest.mark.parametrize("shape", [(3,), (1, 3), (2, 2, 2), (0, 2), (0,)])
def test_an_eta_of_a_wrong_shape_is_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(
        ShapeError, match=r"eta: expected a number, shape \(2,\), one per sensor .*\(s1, s2\), or"
    ):
        JointFusion(paper_plant(), eta=np.ones(shape))


def test_eta_and_plant_that_vary_need_a_prior_and_end() -> None:
    fusion = JointFusion(paper_plant(), eta=np.ones((3, 2)))
    assert fusion.no_steady_state.startswith("eta varies in time")
    with pytest.raises(InputError, match="prior: expected a belief with a covariance P"):
        fusion.run(np.zeros((3, 5)))
    fusion.run(np.zeros((3, 5)), prior=PAPER_PRIOR)
    with pytest.raises(ValueError, match="at most 3 samples"):
        fusion.run(np.zeros((4, 5)), prior=PAPER_PRIOR)
    with pytest.raises(ValueError, match="at most 3 samples"):
        fusion.run(np.zeros((2, 4, 5)), prior=PAPER_PRIOR)


def test_moments_say_what_they_need() -> None:
    fusion = JointFusion(paper_plant(), eta=np.ones((3, 2)))
    with pytest.raises(ShapeError, match="steps: expected at most 3"):
        fusion.moments(4, PAPER_PRIOR)
    with pytest.raises(InputError, match="steps"):
        fusion.moments(0, PAPER_PRIOR)
    with pytest.raises(InputError, match=r"prior: expected a Belief with a covariance P \(4, 4\)"):
        fusion.moments(1, Belief(np.zeros(4)))
    with pytest.raises(ShapeError, match=r"missing: expected booleans of shape \(5,\) or \(2, 5\)"):
        fusion.moments(2, PAPER_PRIOR, missing=np.zeros((3, 5), dtype=bool))
    with pytest.raises(ShapeError, match="missing"):
        fusion.moments(2, PAPER_PRIOR, missing=np.zeros(5))
    for settings in ({"eta": "adaptive"}, {"protected": "auto"}):
        with pytest.raises(InputError, match="moments: expected an eta and a protected set that are given"):
            JointFusion(paper_plant(), **settings).moments(2, PAPER_PRIOR)  # type: ignore[arg-type]


def test_settings_say_what_was_chosen() -> None:
    settings = JointFusion(paper_plant(), eta={"s1": 1.0, "s2": 2.0}, pairing=PAPER_PAIRS).settings
    assert settings["eta"] == {"s1": 1.0, "s2": 2.0} and settings["pairing"] == PAPER_PAIRS
    assert (
        settings["form"] == "exact" and settings["square_root"] is False and settings["fusion"] == "optimal"
    )
    assert JointFusion(paper_plant(), eta="adaptive").settings["eta"] == "adaptive"
    assert AdaptiveJointFilter(paper_plant()).settings["window"] == settings["window"]


def three_weak(seed: int, count: int) -> Plant:
    """`count` sensors that may lie, with two that do not."""
    plant, rng = random_plant(seed, radius=0.8), np.random.default_rng(seed)
    rows = rng.normal(size=(count + 2, 3))
    return Plant(
        plant.A, plant.Q, [Sensor(f"s{i}", C=C, R=0.5, protected=i >= count) for i, C in enumerate(rows)]
    )


@pytest.mark.parametrize("count", [2, 3])
@pytest.mark.parametrize("seed", range(4))
def test_covariance_intersection_finds_the_weights_of_least_trace(seed: int, count: int) -> None:
    plant = three_weak(seed, count)
    pairing = {f"s{i}": [f"s{count + i % 2}"] for i in range(count)}
    moments = JointFusion(plant, pairing=pairing, fusion="covariance-intersection").moments(
        8, some_prior(plant)
    )
    for G, Sigma in zip(moments.G, moments.Sigma, strict=True):
        information = [np.linalg.inv(Sigma[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]) for i in range(count)]

        def trace(omega: Array, information: list[Array] = information) -> float:
            return float(np.trace(np.linalg.inv(sum(w * Y for w, Y in zip(omega, information, strict=True)))))

        best = minimize(
            trace,
            np.full(count, 1 / count),
            method="SLSQP",
            bounds=[(0, 1)] * count,
            constraints={"type": "eq", "fun": lambda omega: omega.sum() - 1},
            options={"ftol": 1e-15, "maxiter": 500},
        )
        # G_i = omega_i P Y_i with P = (sum omega_i Y_i)^-1: so omega_i is as the size of G_i Y_i^-1.
        P = np.linalg.inv(sum(w * Y for w, Y in zip(best.x, information, strict=True)))
        expected = np.hstack([w * P @ Y for w, Y in zip(best.x, information, strict=True)])
        blocks = [(G[:, 3 * i : 3 * i + 3], Y) for i, Y in enumerate(information)]
        ratios = np.array([np.linalg.norm(block @ np.linalg.inv(Y)) for block, Y in blocks])
        omega = ratios / ratios.sum()
        assert trace(omega) <= best.fun * (1 + 1e-9)
        np.testing.assert_allclose(omega, best.x, atol=1e-6)
        np.testing.assert_allclose(G, expected, atol=1e-5)


def test_averages_weigh_every_local_the_same() -> None:
    moments = JointFusion(three_weak(0, 3), fusion="average").moments(2, some_prior(three_weak(0, 3)))
    np.testing.assert_array_equal(moments.G, np.tile(np.eye(3) / 3, (2, 1, 3)))

"""Plants, sensors and beliefs: what is accepted, what is refused and with which words."""

import copy
import pickle
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

from securestate import Belief, InputError, Plant, PlantError, SecurestateError, Sensor, ShapeError

A = [[1.0, 0.1], [0.0, 1.0]]
Q = [[0.0, 0.0], [0.0, 1.0]]


def sensor(name: str = "s", **changes: Any) -> Sensor:
    return Sensor(**{"name": name, "C": [1.0, 0.0], "R": 1.0} | changes)


def plant(**changes: Any) -> Plant:
    return Plant(**{"A": A, "Q": Q, "sensors": [sensor()]} | changes)


def two_gauges(**changes: Any) -> Plant:
    """Return a plant with every kind of attribute set."""
    sensors = [
        sensor("a", protected=True, unit="bar", offset=3, scale=2),
        sensor("b", C=[[1, 0], [0, 1]], R=[1, 2], channels=["low", "high"], unit=["m", "cm"], offset=[1, 2]),
    ]
    given = {"sensors": sensors, "B": [[0.0], [1.0]], "D": [[0.0], [0.5], [0.0]], "dt": 0.5}
    return plant(
        **given | {"name": "tank", "input_names": ["pump"], "input_offset": 4, "input_scale": 8} | changes
    )


def test_attributes_follow_from_the_arguments() -> None:
    p = two_gauges()
    assert (p.n, p.m, p.n_sensors, p.n_inputs) == (2, 3, 2, 1)
    assert (p.dt, p.name, p.time_varying, p.horizon) == (0.5, "tank", False, None)
    assert p.channel_names == ("a", "low", "high")
    assert (p.sensor_names, p.state_names, p.input_names) == (("a", "b"), ("x1", "x2"), ("pump",))
    assert p.units == ("bar", "m", "cm")
    np.testing.assert_array_equal(p.C, [[1, 0], [1, 0], [0, 1]])
    np.testing.assert_array_equal(p.R, np.diag([1, 1, 2]))
    np.testing.assert_array_equal(p.offset, [3, 1, 2])
    np.testing.assert_array_equal(p.scale, [2, 1, 1])
    np.testing.assert_array_equal(p.protected, [True, False])
    np.testing.assert_array_equal(p.channel_sensor, [0, 1, 1])
    assert p.channel_sensor.dtype == np.int64
    assert (p.channels_of(0), p.channels_of(1)) == (slice(0, 1), slice(1, 3))


def test_integers_become_float64() -> None:
    p = Plant([[1]], [[1]], [Sensor("s", C=[1], R=1)])
    assert {array.dtype for array in (p.A, p.Q, p.C, p.R, p.B, p.D)} == {np.dtype(np.float64)}


def test_several_channels_are_numbered_from_one() -> None:
    assert sensor("flow", C=np.eye(2)).channels == ("flow.1", "flow.2")


def test_without_inputs_b_and_d_have_no_columns() -> None:
    assert (plant().B.shape, plant().D.shape, plant().input_names) == ((2, 0), (1, 0), ())


def test_feedthrough_alone_makes_inputs_that_do_not_move_the_state() -> None:
    p = plant(sensors=[sensor("a", D=[2.0, 3.0]), sensor("b")])
    np.testing.assert_array_equal(p.B, np.zeros((2, 2)))
    np.testing.assert_array_equal(p.D, [[2, 3], [0, 0]])
    np.testing.assert_array_equal(plant(D=[[2.0]]).B, np.zeros((2, 1)))


@pytest.mark.parametrize(("given", "full"), [(4, 4 * np.eye(2)), ([4, 9], np.diag([4, 9]))])
def test_noise_of_a_sensor_may_be_a_variance_or_variances(given: object, full: object) -> None:
    np.testing.assert_array_equal(sensor(C=np.eye(2), R=given).R, full)


def test_noise_may_be_correlated_between_sensors() -> None:
    R = [[2.0, 1.0], [1.0, 2.0]]
    np.testing.assert_array_equal(plant(sensors=[sensor("a", R=None), sensor("b", R=None)], R=R).R, R)


def test_dynamics_and_measurements_may_vary_in_time() -> None:
    p = plant(A=np.stack([A] * 5), sensors=[sensor("a"), sensor("b", C=np.ones((5, 1, 2)))])
    assert (p.A.shape, p.C.shape, p.time_varying, p.horizon) == ((5, 2, 2), (5, 2, 2), True, 5)
    np.testing.assert_array_equal(p.C[3], [[1, 0], [1, 1]])
    assert plant(A=np.stack([A] * 5)).C.shape == (1, 2)


def test_a_sensor_may_be_blind_at_some_samples() -> None:
    C = np.zeros((3, 1, 2))
    C[1] = 1
    assert plant(sensors=[sensor(C=C)]).horizon == 3


def test_the_operating_point_turns_files_into_model_units_and_back() -> None:
    p = two_gauges()
    y = np.array([[5.0, 2.0, 4.0], [np.nan, 1.0, 2.0]])
    np.testing.assert_array_equal(p.normalise(y), [[1, 1, 2], [np.nan, 0, 0]])
    np.testing.assert_array_equal(p.denormalise(p.normalise(y)), y)
    np.testing.assert_array_equal(p.normalise_input(np.array([20.0])), [2])


def test_rounding_in_a_covariance_is_averaged_away() -> None:
    p = plant(Q=[[1.0, 0.5], [0.5 + 1e-13, 1.0]])
    assert p.Q[0, 1] == p.Q[1, 0] == pytest.approx(0.5, abs=1e-12)


def test_a_low_rank_process_noise_is_accepted_despite_rounding() -> None:
    G = np.random.default_rng(1).normal(size=(8, 2))
    Qw = G @ G.T
    assert np.linalg.eigvalsh(Qw)[0] < 1e-14
    sensors = [Sensor("s", C=np.ones(8), R=1)]
    assert Plant(np.eye(8), Qw, sensors).n == 8


def test_covariances_in_very_different_units_are_accepted() -> None:
    assert sensor(C=np.eye(2), R=[1e12, 1e-12]).R is not None


SENSOR_MISTAKES: list[tuple[dict[str, Any], str]] = [
    ({"name": ""}, "sensor name: expected text that is not empty, received ''"),
    ({"name": 3}, "sensor name: expected text, received 3 (int)"),
    ({"name": " a"}, "sensor name: expected printable text without blanks at its ends"),
    ({"name": "a\nb"}, "sensor name: expected printable text"),
    ({"C": [[1.0, np.inf]]}, "sensor 's': C: expected finite numbers, received inf at [0, 1]"),
    (
        {"C": [[0, 0], [1, 0]]},
        "C: expected channels that see some state, received row 0 all zero",
    ),
    ({"C": np.zeros((3, 1, 2))}, "received row 0 all zero"),
    ({"C": 1.0}, "sensor 's': C: expected shape (n,), (c, n) or (T, c, n), received shape ()"),
    ({"C": []}, "sensor 's': C: expected shape (n,), (c, n) or (T, c, n), received shape (0,)"),
    ({"C": "1 0"}, "sensor 's': C: expected an array of real numbers, received text"),
    ({"C": [1j, 0]}, "sensor 's': C: expected an array of real numbers, received complex numbers"),
    ({"C": [True, False]}, "sensor 's': C: expected an array of real numbers, received booleans"),
    ({"C": [[1, 0], [1]]}, "sensor 's': C: expected an array of real numbers, received list"),
    ({"C": None}, "sensor 's': C: expected an array of real numbers, received None (NoneType)"),
    ({"C": np.ma.masked_array([1.0, 2.0], [0, 1])}, "sensor 's': C: expected an array without a mask"),
    ({"C": [10**400, 1]}, "sensor 's': C: expected an array of real numbers"),
    ({"R": 0}, "sensor 's': R: expected variances > 0 on the diagonal, received 0.0 at [0, 0]"),
    ({"R": np.nan}, "sensor 's': R: expected finite numbers, received nan"),
    ({"R": [1, 2]}, "sensor 's': R: expected shape (), (1,) or (1, 1), one per channel, received shape (2,)"),
    ({"C": np.eye(2), "R": [[1, 2], [2, 1]]}, "sensor 's': R: expected a positive definite matrix"),
    ({"C": np.eye(2), "R": [[1, 1], [1, 1]]}, "sensor 's': R: expected a positive definite matrix"),
    ({"C": np.eye(2), "R": [[1e-300, 1e300], [1e300, 1e-300]]}, "received a correlation outside -1..1"),
    ({"C": np.eye(2), "R": [[1, 0.5], [0.4, 1]]}, "sensor 's': R: expected a symmetric matrix"),
    ({"D": [[1], [2]]}, "sensor 's': D: expected shape (1, p), received shape (2, 1)"),
    ({"D": "x"}, "sensor 's': D: expected an array of real numbers"),
    ({"verifiable": 0}, "sensor 's': verifiable: expected True or False, received 0 (int)"),
    ({"protected": 1}, "sensor 's': protected: expected True or False, received 1 (int)"),
    ({"channels": ["a", "b"]}, "sensor 's': channels: expected 1 names, received 2"),
    ({"channels": "a"}, "sensor 's': channels: expected a list of text"),
    ({"channels": [7]}, "sensor 's': channels[0]: expected text, received 7 (int)"),
    (
        {"C": np.eye(2), "channels": ["a", "a"]},
        "channels: expected names that differ, received 'a' twice",
    ),
    ({"offset": np.nan}, "sensor 's': offset: expected finite numbers"),
    (
        {"offset": [1, 2]},
        "sensor 's': offset: expected one number or 1, one per channel, received shape (2,)",
    ),
    ({"scale": 0}, "sensor 's': scale: expected numbers > 0, received 0.0"),
    ({"scale": -2}, "sensor 's': scale: expected numbers > 0, received -2.0"),
    ({"unit": 3}, "sensor 's': unit: expected a list of text, received 3 (int)"),
    ({"unit": ["m", "m"]}, "sensor 's': unit: expected 1 names, received 2"),
]

PLANT_MISTAKES: list[tuple[dict[str, Any], str]] = [
    ({"A": [[1, 0]]}, "A: expected shape (n, n) or (T, n, n), received shape (1, 2)"),
    ({"A": np.zeros((0, 0))}, "A: expected shape (n, n) or (T, n, n), received shape (0, 0)"),
    ({"A": np.zeros((0, 2, 2))}, "A: expected shape (n, n) or (T, n, n), received shape (0, 2, 2)"),
    ({"A": [[1, np.nan], [0, 1]]}, "A: expected finite numbers, received nan at [0, 1]"),
    ({"A": "identity"}, "A: expected an array of real numbers, received text"),
    ({"A": {}}, "A: expected an array of real numbers, received {} (dict)"),
    ({"Q": [[1]]}, "Q: expected shape (2, 2), n from A, received shape (1, 1)"),
    ({"Q": [[1, 0.5], [0.4, 1]]}, "Q: expected a symmetric matrix, received 0.5 at [0, 1] but 0.4 at [1, 0]"),
    ({"Q": [[1, 0.5], [0.5 + 1e-11, 1]]}, "Q: expected a symmetric matrix"),
    ({"Q": [[1, 1e308], [-1e308, 1]]}, "Q: expected a symmetric matrix"),
    ({"Q": [[1, 2], [2, 1]]}, "Q: expected a positive semidefinite matrix, received smallest eigenvalue -1"),
    ({"Q": [[1, 0], [0, -1e-6]]}, "Q: expected a positive semidefinite matrix"),
    ({"Q": [[np.inf, 0], [0, 1]]}, "Q: expected finite numbers, received inf at [0, 0]"),
    ({"sensors": []}, "sensors: expected at least one Sensor, received none"),
    ({"sensors": None}, "sensors: expected a list of Sensor, received None (NoneType)"),
    ({"sensors": ["flow"]}, "sensors[0]: expected a Sensor, received 'flow' (str)"),
    ({"sensors": sensor()}, "sensors: expected a list of Sensor, received Sensor('s', channels=1)"),
    ({"sensors": [sensor(), sensor()]}, "sensors: expected names that differ, received 's' twice"),
    (
        {"sensors": [sensor("a", channels=["c"]), sensor("b", channels=["c"])]},
        "channels of the sensors: expected names that differ, received 'c' twice",
    ),
    (
        {"sensors": [sensor(C=[1])]},
        "sensor 's': C: expected 2 columns, one per state of A, received shape (1, 1)",
    ),
    (
        {"sensors": [sensor(R=None)]},
        "sensor 's': R: expected a noise covariance, here or on the plant, received none",
    ),
    ({"R": 1}, "R: expected R on the plant or on its sensors, received both (sensor 's' has one)"),
    ({"sensors": [sensor(R=None)], "R": np.eye(2)}, "R: expected shape (), (1,) or (1, 1)"),
    (
        {"sensors": [sensor("a", R=None), sensor("b", R=None)], "R": [[1, 1], [1, 1]]},
        "R: expected a positive definite matrix",
    ),
    ({"B": [[1.0]]}, "B: expected shape (2, p), n from A, received shape (1, 1)"),
    ({"B": [1.0, 0.0]}, "B: expected shape (2, p), n from A, received shape (2,)"),
    ({"B": [["x"], ["y"]]}, "B: expected an array of real numbers, received text"),
    (
        {"B": np.ones((2, 2)), "D": [[1.0]]},
        "D: expected 2 columns, one per input of B, received shape (1, 1)",
    ),
    ({"D": [[1.0], [2.0]]}, "D: expected shape (1, p), a row per channel, received shape (2, 1)"),
    (
        {"sensors": [sensor(D=[1])], "D": [[1.0]]},
        "D: expected D on the plant or on its sensors, received both (sensor 's' has one)",
    ),
    (
        {"sensors": [sensor("a", D=[1]), sensor("b", D=[1, 2])]},
        "sensor 'b': D: expected 1 columns like sensor 'a', received shape (1, 2)",
    ),
    ({"dt": 0}, "dt: expected one number > 0, received 0 (int)"),
    ({"dt": -1.0}, "dt: expected one number > 0, received -1.0 (float)"),
    ({"dt": np.inf}, "dt: expected finite numbers, received inf"),
    ({"dt": "1"}, "dt: expected an array of real numbers, received text"),
    ({"dt": [1, 2]}, "dt: expected one number > 0"),
    ({"dt": True}, "dt: expected an array of real numbers, received booleans"),
    ({"state_names": ["a"]}, "state_names: expected 2 names, received 1"),
    ({"state_names": ["a", "a"]}, "state_names: expected names that differ, received 'a' twice"),
    ({"state_names": "ab"}, "state_names: expected a list of text, received 'ab' (str)"),
    ({"input_names": ["u"]}, "input_names: expected no names, as there is neither B nor D"),
    ({"B": np.ones((2, 2)), "input_names": ["u", "u"]}, "input_names: expected names that differ"),
    ({"B": np.ones((2, 1)), "input_offset": np.nan}, "input_offset: expected finite numbers"),
    ({"B": np.ones((2, 1)), "input_scale": 0}, "input_scale: expected numbers > 0, received 0.0"),
    ({"B": np.ones((2, 1)), "input_scale": [1, 2]}, "input_scale: expected one number or 1, one per input"),
    ({"name": None}, "name: expected text, received None (NoneType)"),
    (
        {"A": np.stack([A] * 3), "sensors": [sensor(C=np.ones((4, 1, 2)))]},
        "sensor 's': C: expected 3 samples on its time axis, like A, received 4",
    ),
    (
        {"sensors": [sensor("a", C=np.ones((4, 1, 2))), sensor("b", C=np.ones((3, 1, 2)))]},
        "sensor 'b': C: expected 4 samples like sensor 'a', received 3 samples",
    ),
]


@pytest.mark.parametrize(("changes", "message"), SENSOR_MISTAKES)
def test_a_wrong_sensor_is_refused_naming_what_is_wrong(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(PlantError) as caught:
        sensor(**changes)
    assert message in str(caught.value)


@pytest.mark.parametrize(("changes", "message"), PLANT_MISTAKES)
def test_a_wrong_plant_is_refused_naming_what_is_wrong(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(PlantError) as caught:
        plant(**changes)
    assert message in str(caught.value)


def test_an_error_carries_argument_expected_and_received() -> None:
    with pytest.raises(PlantError) as caught:
        plant(dt=-1.0)
    error = pickle.loads(pickle.dumps(caught.value))
    assert (error.argument, error.expected, error.received) == ("dt", "one number > 0", "-1.0 (float)")
    assert isinstance(error, SecurestateError) and isinstance(error, ValueError)


leaf = st.none() | st.booleans() | st.integers() | st.floats() | st.complex_numbers()
junk = st.recursive(
    leaf | st.text(max_size=3) | st.binary(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=2), inner, max_size=2),
    max_leaves=6,
)


@given(
    st.sampled_from(["A", "Q", "sensors", "B", "D", "R", "dt", "state_names", "input_names", "name"]), junk
)
def test_junk_gives_a_plant_or_a_plant_error(argument: str, value: object) -> None:
    try:
        assert isinstance(plant(**{argument: value}), Plant)
    except PlantError as error:
        assert error.expected


@given(
    st.sampled_from(
        ["name", "C", "R", "D", "protected", "verifiable", "channels", "offset", "scale", "unit"]
    ),
    junk,
)
def test_junk_gives_a_sensor_or_a_plant_error(argument: str, value: object) -> None:
    try:
        assert isinstance(sensor(**{argument: value}), Sensor)
    except PlantError as error:
        assert error.expected


def test_arrays_are_copies_that_cannot_be_written() -> None:
    mine = np.array(A)
    p = plant(A=mine)
    mine[0, 0] = 7
    assert p.A[0, 0] == 1
    for array in (
        p.A,
        p.Q,
        p.C,
        p.R,
        p.B,
        p.D,
        p.offset,
        p.scale,
        p.protected,
        p.verifiable,
        p.channel_sensor,
        p.sensors[0].C,
    ):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


def test_attributes_cannot_be_set_or_deleted() -> None:
    for value, name in ((plant(), "dt"), (sensor(), "name"), (Belief([0]), "x")):
        with pytest.raises(AttributeError, match="immutable"):
            setattr(value, name, 1)
        with pytest.raises(AttributeError, match="immutable"):
            delattr(value, name)


def test_equality_is_by_value_and_hashing_is_off() -> None:
    assert two_gauges() == two_gauges()
    assert two_gauges() != plant()
    assert sensor() == sensor()
    assert sensor() != sensor(scale=2)
    assert plant() != plant(sensors=[sensor(verifiable=False)])
    assert plant() != "plant"
    for value in (plant(), sensor(), Belief([0])):
        with pytest.raises(TypeError, match="unhashable"):
            hash(value)


@pytest.mark.parametrize(
    "change",
    [
        *(
            {"dt": 1.0},
            {"name": "x"},
            {"state_names": ["p", "v"]},
            {"input_offset": 1},
            {"input_names": ["v"]},
        ),
        *({"A": np.eye(2)}, {"Q": np.eye(2)}, {"B": [[1.0], [1.0]]}, {"D": [[1.0], [0], [0]]}),
    ],
)
def test_any_difference_makes_plants_unequal(change: dict[str, Any]) -> None:
    assert two_gauges() != two_gauges(**change)


def test_it_does_not_matter_for_equality_where_the_noise_was_given() -> None:
    assert plant() == plant(sensors=[sensor(R=None)], R=1)


@pytest.mark.parametrize("again", [copy.copy, copy.deepcopy, lambda value: pickle.loads(pickle.dumps(value))])
def test_copies_are_equal_and_still_immutable(again: Callable[[Plant], Plant]) -> None:
    p = again(two_gauges())
    assert p == two_gauges()
    assert not p.A.flags.writeable
    assert not p.sensors[1].C.flags.writeable


def test_reprs_are_short() -> None:
    assert repr(two_gauges()) == "Plant('tank', n=2, m=3, sensors=2, inputs=1, dt=0.5 s)"
    assert repr(plant(A=np.stack([A] * 4))) == "Plant(n=2, m=1, sensors=1, inputs=0, horizon=4, dt=1 s)"
    assert repr(two_gauges().sensors[0]) == "Sensor('a', channels=1, protected)"
    assert repr(sensor(verifiable=False)) == "Sensor('s', channels=1, not verifiable)"


@pytest.mark.parametrize("index", [-1, 2])
def test_channels_of_a_sensor_that_does_not_exist_are_refused(index: int) -> None:
    with pytest.raises(InputError, match=r"sensor: expected an index in 0\.\.1"):
        two_gauges().channels_of(index)


def test_selected_sensors_keep_all_that_belongs_to_them() -> None:
    p = two_gauges().select([1])
    assert (p.sensor_names, p.channel_names, p.units) == (("b",), ("low", "high"), ("m", "cm"))
    np.testing.assert_array_equal(p.R, np.diag([1, 2]))
    np.testing.assert_array_equal(p.D, [[0.5], [0]])
    assert two_gauges().select([0, 1]) == two_gauges()
    with pytest.raises(PlantError, match="at least one Sensor"):
        two_gauges().select([])


def test_selected_sensors_keep_their_correlations_and_order() -> None:
    R = np.array([[3.0, 1, 0.5], [1, 4, 0], [0.5, 0, 5]])
    p = plant(sensors=[sensor(name, R=None) for name in "abc"], R=R).select([2, 0])
    assert p.sensor_names == ("c", "a")
    np.testing.assert_array_equal(p.R, [[5, 0.5], [0.5, 3]])


def marked(**changes: Any) -> Plant:
    """Return a plant with a sensor of each kind."""
    sensors = [
        sensor("plain"),
        sensor("alone", verifiable=False),
        sensor("sealed", verifiable=False, protected=True),
    ]
    return plant(sensors=sensors, **changes)


def test_only_who_may_lie_and_nobody_vouches_for_cannot_be_checked() -> None:
    np.testing.assert_array_equal(marked().verifiable, [True, False, False])
    np.testing.assert_array_equal(marked().uncheckable, [False, True, False])


def test_whoever_changes_a_plant_keeps_who_vouches_for_whom() -> None:
    p = marked(A=np.stack([A] * 4))
    np.testing.assert_array_equal(p.select([1, 0]).verifiable, [False, True])
    np.testing.assert_array_equal(p.with_sensors([sensor("new")]).verifiable, [True, False, False, True])
    np.testing.assert_array_equal(p.with_protected([1]).verifiable, p.verifiable)
    np.testing.assert_array_equal(p.with_protected([1]).uncheckable, [False] * 3)
    np.testing.assert_array_equal(p.from_sample(2).verifiable, p.verifiable)
    moving = sensor("alone", C=np.ones((4, 1, 2)), verifiable=False)
    assert not moving.from_sample(1).verifiable
    assert not moving.replaced(name="other").verifiable
    assert moving.replaced(verifiable=True).verifiable


def test_a_belief_holds_mean_and_covariance() -> None:
    belief = Belief([1, 2], [[1, 0], [0, 0]])
    np.testing.assert_array_equal(belief.x, [1.0, 2.0])
    assert belief.P is not None and not belief.P.flags.writeable
    assert Belief([1, 2]).P is None
    assert belief == Belief([1, 2], [[1, 0], [0, 0]]) != Belief([1, 2])


@pytest.mark.parametrize(
    ("x", "P", "kind", "message"),
    [
        ([[1.0]], None, ShapeError, "x: expected shape (n,), received shape (1, 1)"),
        ([], None, ShapeError, "x: expected shape (n,), received shape (0,)"),
        ([1.0], np.eye(2), ShapeError, "P: expected shape (1, 1) to fit x, received shape (2, 2)"),
        ([np.nan], None, InputError, "x: expected finite numbers, received nan at [0]"),
        (["a"], None, InputError, "x: expected an array of real numbers, received text"),
        ([1.0], [[-1.0]], InputError, "P: expected a positive semidefinite matrix"),
    ],
)
def test_a_wrong_belief_is_refused(x: Any, P: Any, kind: type[Exception], message: str) -> None:
    with pytest.raises(kind) as caught:
        Belief(x, P)
    assert message in str(caught.value)


def test_a_python_control_system_keeps_its_names() -> None:
    control = pytest.importorskip("control")
    system = control.ss(
        A,
        [[0], [1]],
        np.eye(2),
        [[0], [0.5]],
        0.2,
        states=["p", "v"],
        inputs=["force"],
        outputs=["gps", "radar"],
    )
    p = Plant.from_control(system, Q, [1, 2], protected=["radar"], name="cart")
    assert (p.state_names, p.input_names, p.sensor_names) == (("p", "v"), ("force",), ("gps", "radar"))
    assert (p.dt, p.name) == (0.2, "cart")
    np.testing.assert_array_equal(p.protected, [False, True])
    for mine, theirs in ((p.A, system.A), (p.B, system.B), (p.C, system.C), (p.D, system.D)):
        np.testing.assert_array_equal(mine, theirs)
    np.testing.assert_array_equal(p.R, np.diag([1, 2]))
    renamed = Plant.from_control(
        system, Q, 1, sensor_names=["a", "b"], state_names=["c", "d"], input_names=["e"]
    )
    assert (renamed.sensor_names, renamed.state_names, renamed.input_names) == (
        ("a", "b"),
        ("c", "d"),
        ("e",),
    )


def test_a_python_control_system_without_a_said_sample_time_has_one_second() -> None:
    control = pytest.importorskip("control")
    assert Plant.from_control(control.ss([[1]], [[1]], [[1]], [[0]], True), [[1]], 1).dt == 1.0


@pytest.mark.parametrize("dt", [0, None])
def test_a_continuous_python_control_system_is_refused_with_advice(dt: object) -> None:
    control = pytest.importorskip("control")
    system = control.ss([[1]], [[1]], [[1]], [[0]], dt)
    with pytest.raises(
        PlantError, match="sys: expected a discrete-time system; sample a continuous one first"
    ):
        Plant.from_control(system, [[1]], 1)


def test_a_scipy_system_gets_numbered_names() -> None:
    p = Plant.from_scipy(signal.dlti(A, [[0], [1]], [[1, 0]], [[0]], dt=0.1), Q, 2.0)
    assert (p.dt, p.sensor_names, p.state_names, p.input_names) == (0.1, ("y1",), ("x1", "x2"), ("u1",))
    np.testing.assert_array_equal(p.R, [[2]])


def test_scipy_systems_without_a_sample_time_or_matrices_are_refused() -> None:
    with pytest.raises(PlantError, match="expected a discrete-time system"):
        Plant.from_scipy(signal.lti(A, [[0], [1]], [[1, 0]], [[0]]), Q, 1)
    with pytest.raises(PlantError, match="state-space system with A, B, C, D"):
        Plant.from_scipy(signal.dlti([1], [1, 0.5], dt=1), [[1]], 1)


def test_a_foreign_system_with_wrong_parts_is_refused_naming_them() -> None:
    system = SimpleNamespace(A=[[1.0]], B=[[1.0]], C=[[1.0]], D=[[0.0]], dt=-1)
    with pytest.raises(PlantError, match=r"sys\.dt: expected one number > 0"):
        Plant.from_control(system, [[1]], 1)
    with pytest.raises(PlantError, match=r"sys\.A: expected two dimensions"):
        Plant.from_control(SimpleNamespace(A=[1.0], B=[[1.0]], C=[[1.0]], D=[[0.0]], dt=1), [[1]], 1)
    system.dt = 1
    with pytest.raises(PlantError, match="protected: expected names among y1, received 'gps'"):
        Plant.from_control(system, [[1]], 1, protected=["gps"])
    with pytest.raises(PlantError, match="sensor_names: expected 1 names, received 2"):
        Plant.from_control(system, [[1]], 1, sensor_names=["a", "b"])


def test_readings_and_successors_are_what_the_equations_say() -> None:
    rng = np.random.default_rng(1)
    A, C = rng.normal(size=(6, 2, 2)), rng.normal(size=(6, 3, 2))
    B, D = rng.normal(size=(2, 1)), rng.normal(size=(3, 1))
    sensor = Sensor("s", C=C, R=1.0, offset=[1.0, 2.0, 3.0], scale=[4.0, 5.0, 6.0])
    plant = Plant(A, np.eye(2), [sensor], B=B, D=D, input_offset=7.0, input_scale=2.0)
    x, u = rng.normal(size=(2, 4, 2)), rng.normal(size=(2, 4, 1))
    for r in range(2):
        for k in range(4):
            driven = (u[r, k] - 7.0) / 2.0
            seen = C[k + 2] @ x[r, k] + D @ driven
            np.testing.assert_allclose(plant.reading(x, u, 2)[r, k], [1.0, 2.0, 3.0] + seen * [4.0, 5.0, 6.0])
            np.testing.assert_allclose(plant.successor(x, u, 2)[r, k], A[k + 2] @ x[r, k] + B @ driven)

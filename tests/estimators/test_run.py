"""What a run holds, how it is labelled and joined, and what the common front door refuses."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

from securestate import (
    Belief,
    Estimate,
    InputError,
    KalmanFilter,
    Plant,
    Run,
    Sensor,
    ShapeError,
    SparseFusion,
)
from securestate.estimators import Estimator, Status
from tests.estimators.sparse_cases import liu, liu_record

SHAPES = {
    "x": (3,),
    "x_std": (3,),
    "P": (3, 3),
    "trust": (5,),
    "attack": (5,),
    "attack_std": (5,),
    "suspected": (5,),
    "innovation": (5,),
    "innovation_std": (5,),
    "status": (),
}


def both() -> list[Estimator]:
    return [KalmanFilter(liu()), SparseFusion(liu())]


def records(runs: int, steps: int) -> tuple[np.ndarray, np.ndarray]:
    pairs = [liu_record(steps, seed)[1:] for seed in range(runs)]
    return np.stack([y for y, _ in pairs]), np.stack([u for _, u in pairs])


@pytest.mark.parametrize("estimator", both(), ids=lambda e: e.name)
def test_arrays_have_the_promised_shapes_for_one_run_and_for_a_batch(estimator: Estimator) -> None:
    y, u = records(2, 7)
    for run, lead in ((estimator.run(y[0], u[0]), (7,)), (estimator.run(y, u), (2, 7))):
        assert {name: getattr(run, name).shape for name in SHAPES} == {n: lead + s for n, s in SHAPES.items()}
        assert all(values.shape == lead for values in run.diagnostics.values())
        assert run.suspected.dtype == bool
        assert run.steps == 7
        assert run.runs == (2 if len(lead) == 2 else None)


@pytest.mark.parametrize("estimator", both(), ids=lambda e: e.name)
def test_a_batch_may_share_one_input_record(estimator: Estimator) -> None:
    y, u = records(2, 7)
    shared = estimator.run(y, u[0])
    np.testing.assert_array_equal(shared.x[1], estimator.run(y[1], u[0]).x)


@pytest.mark.parametrize("estimator", both(), ids=lambda e: e.name)
def test_covariances_can_be_left_out(estimator: Estimator) -> None:
    y, u = records(1, 7)
    lean = estimator.run(y[0], u[0], covariance=False)
    assert lean.P is None
    np.testing.assert_array_equal(lean.x_std, estimator.run(y[0], u[0]).x_std)


def test_blocks_of_one_filter_join_to_the_whole_run() -> None:
    y, u = records(1, 20)
    for estimator in both():
        whole, live = estimator.run(y[0], u[0]), estimator.start()
        joined = Run.concat([live.run(y[0][a:b], u[0][a:b]) for a, b in ((0, 1), (1, 8), (8, 20))])
        for name in SHAPES:
            np.testing.assert_array_equal(getattr(joined, name), getattr(whole, name), err_msg=name)
        assert joined.diagnostics.keys() == whole.diagnostics.keys()
    with pytest.raises(InputError, match="at least one run"):
        Run.concat([])


def test_labels_in_xarray_are_those_of_the_plant() -> None:
    y, u = records(2, 7)
    data = SparseFusion(liu()).run(y, u).to_xarray()
    assert data["attack"].dims == ("run", "time", "channel")
    assert list(data["sensor"].values) == ["s1", "s2", "s3", "s4", "s5"]
    assert data["P"].shape == (2, 7, 3, 3)
    assert data.attrs["estimator"] == "SparseFusion"
    assert float(data["trust"].sel(sensor="s2").max()) <= 1


def test_columns_in_pandas_are_named_quantity_dot_name() -> None:
    y, u = records(2, 7)
    run = KalmanFilter(liu()).run(y[0], u[0])
    table = run.with_time(10.0 * np.arange(7)).to_pandas()
    assert list(table.index) == [0, 10, 20, 30, 40, 50, 60]
    np.testing.assert_array_equal(table["innovation.s4"], run.innovation[:, 3])
    batch = KalmanFilter(liu()).run(y, u).to_pandas()
    assert batch.index.names == ["run", "time"]
    assert len(batch) == 14


def test_times_must_be_as_many_as_samples() -> None:
    y, u = records(1, 7)
    with pytest.raises(ShapeError, match=r"time: expected shape \(7,\)"):
        KalmanFilter(liu()).run(y[0], u[0]).with_time(np.arange(6.0))


def test_a_run_plots_every_sensor_and_a_batch_says_what_to_do() -> None:
    y, u = records(2, 7)
    figure = SparseFusion(liu()).run(y[0], u[0]).plot()
    assert list(figure.data[0].y) == ["s1", "s2", "s3", "s4", "s5"]
    assert len(figure.data) == 6
    with pytest.raises(InputError, match="batch of 2 runs"):
        SparseFusion(liu()).run(y, u).plot()


def test_a_plot_names_who_cannot_be_checked_and_colours_no_trust_in_it() -> None:
    y, u = records(1, 7)
    plain = liu()
    sensors = [s.replaced(verifiable=i != 2) for i, s in enumerate(plain.sensors)]
    trust = KalmanFilter(Plant(plain.A, plain.Q, sensors, B=plain.B)).run(y[0], u[0]).plot().data[0]
    assert list(trust.y) == ["s1", "s2", "s3 (cannot be checked)", "s4", "s5"]
    assert np.isnan(trust.z[2]).all() and (trust.z[3] == 1).all()


def test_a_run_is_immutable_and_describes_itself() -> None:
    y, u = records(1, 7)
    run = SparseFusion(liu()).run(y[0], u[0])
    assert "SparseFusion, 7 samples" in repr(run)
    with pytest.raises(dataclasses.FrozenInstanceError):
        run.x = y[0]  # type: ignore[misc]


def test_a_live_step_returns_an_estimate_for_lists_and_strided_arrays_too() -> None:
    y, u = records(1, 3)
    wide = np.zeros((3, 10))
    wide[:, ::2] = y[0]
    for estimator in both():
        expected = estimator.start().step(y[0, 0], u[0, 0])
        assert isinstance(expected, Estimate)
        assert expected.status == Status.OK
        assert "Estimate(x=" in repr(expected)
        for form in (y[0, 0].tolist(), wide[0, ::2], y[0, 0].astype(object).tolist()):
            np.testing.assert_array_equal(estimator.start().step(form, list(u[0, 0])).x, expected.x)


@pytest.mark.parametrize(
    ("y", "u", "message"),
    [
        (np.zeros((7, 4)), np.zeros((7, 3)), r"y: expected shape \(T, 5\)"),
        (np.zeros(5), np.zeros((7, 3)), r"y: expected shape \(T, 5\)"),
        (np.zeros((0, 5)), np.zeros((0, 3)), r"y: expected shape \(T, 5\)"),
        (np.zeros((7, 5)), None, "because the plant has inputs"),
        (np.zeros((7, 5)), np.zeros((6, 3)), r"u: expected shape \(7, 3\)"),
        (np.zeros((7, 5)), np.full((7, 3), np.nan), "finite numbers.*input 0 at sample 0"),
        ([["a"] * 5], np.zeros((1, 3)), "an array of real numbers"),
        (np.zeros((7, 5), dtype=complex), np.zeros((7, 3)), "an array of real numbers"),
    ],
)
@pytest.mark.parametrize("estimator", both(), ids=lambda e: e.name)
def test_wrong_records_are_refused_by_name(
    estimator: Estimator, y: np.ndarray, u: np.ndarray | None, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        estimator.run(y, u)


@pytest.mark.parametrize("estimator", both(), ids=lambda e: e.name)
def test_wrong_live_samples_are_refused_and_leave_the_filter_as_it_was(estimator: Estimator) -> None:
    live = estimator.start()
    before = live.save()
    for y, u in (
        (np.zeros(4), np.zeros(3)),
        (np.zeros(5), None),
        (np.zeros(5), np.zeros(2)),
        (np.array([0, 0, np.inf, 0, 0]), np.zeros(3)),
        (np.zeros(5), np.array([np.nan, 0, 0])),
        ("text", np.zeros(3)),
    ):
        with pytest.raises(InputError):
            live.step(y, u)
        assert live.save() == before


def test_a_prior_of_the_wrong_length_is_refused() -> None:
    with pytest.raises(ShapeError, match=r"prior\.x: expected shape \(3,\)"):
        KalmanFilter(liu()).start(Belief(np.zeros(2)))


def test_every_status_has_advice() -> None:
    assert all(len(status.advice) > 20 for status in Status)


def test_estimators_describe_themselves() -> None:
    plant = Plant([[0.5]], [[1.0]], [Sensor("a", C=[[1.0]], R=1.0)], name="tank")
    assert repr(KalmanFilter(plant)).startswith("KalmanFilter(Plant('tank'")
    assert "kalman_probability=0.95" in repr(SparseFusion(plant))


def test_a_table_with_names_is_read_by_name() -> None:
    y, u = records(1, 7)
    table = pd.DataFrame(y[0], columns=["s1", "s2", "s3", "s4", "s5"])
    for estimator in both():
        by_name = estimator.run(table[["s5", "s3", "s1", "s2", "s4"]], u[0])
        np.testing.assert_array_equal(by_name.x, estimator.run(y[0], u[0]).x)
        with pytest.raises(InputError, match="y: expected the columns s1, s2, s3, s4, s5"):
            estimator.run(table.rename(columns={"s2": "other"}), u[0])


def test_a_prior_or_a_plant_of_the_wrong_kind_is_refused() -> None:
    with pytest.raises(InputError, match='prior: expected a Belief, None, or "window" in run, received list'):
        KalmanFilter(liu()).start([0.0, 0.0, 0.0])  # type: ignore[arg-type]
    for method in (KalmanFilter, SparseFusion):
        with pytest.raises(
            InputError, match=r"plant: expected a Plant; Plant\.load reads a file, received str"
        ):
            method("plant.toml")  # type: ignore[arg-type]

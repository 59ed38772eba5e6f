"""Scores against loops written out, and against what is known of the Kalman filter."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from securestate import InnovationGate, KalmanFilter, OracleFilter, Plant, Run, Sensor, SparseFusion
from securestate.attacks import Bias, Denial, Drawn, Pulse, RandomNoise, Redrawn
from securestate.simulation import Trajectory, simulate
from securestate.simulation.metrics import (
    PER_RUN,
    PER_SENSOR,
    Scores,
    error_over_time,
    per_sensor,
    score,
    summarise_scores,
)

FROM = 4


def plant() -> Plant:
    sensors = [
        Sensor("pair", C=[[1.0, 0.0], [1.0, 1.0]], R=[1.0, 0.5], scale=[2.0, 0.5], offset=10.0),
        *(Sensor(f"s{i}", C=[1.0, i - 1.0], R=1.0 + i) for i in range(4)),
    ]
    return Plant([[0.9, 0.2], [-0.1, 0.8]], [[0.5, 0.2], [0.2, 0.4]], sensors)


def met(runs: int = 6, steps: int = 40) -> tuple[Run, Trajectory]:
    attack = (
        RandomNoise(9.0, on=Redrawn((0, 2)), start=10)
        + Bias(20.0, on=Drawn((0, 1)), start=8)
        + Denial(0.1, on=Drawn(2))
    )
    trajectory = simulate(plant(), steps, attack, runs=runs, seed=5)
    return trajectory.confront(SparseFusion(plant()))


def by_hand(run: Run, truth: Trajectory, r: int) -> dict[str, float]:
    """Every score of one run, one sample and one sensor at a time."""
    p, T, N = truth.plant, truth.steps, truth.plant.n_sensors
    noise = p.scale * np.sqrt(np.diag(p.R))
    assert run.P is not None
    square, nees, nis, exact, miss = [], [], [], [], []
    counts = dict.fromkeys(PER_SENSOR, 0.0)
    first_lie, first_find = np.nan, np.inf
    for k in range(FROM, T):
        e = run.x[r, k] - truth.x[r, k]
        square.append(e @ e)
        nees.append(e @ np.linalg.inv(run.P[r, k]) @ e / p.n)
        right = True
        for i in range(N):
            channels = range(*p.channels_of(i).indices(p.m))
            sent = any(not np.isnan(truth.y[r, k, c]) for c in channels)
            attacked, accused = bool(truth.attacked[r, k, i]), bool(run.suspected[r, k, i])
            values = [truth.a[r, k, c] for c in channels if not np.isnan(truth.y[r, k, c])]
            lies = attacked and any(a != 0 for a in values)
            for c in channels:
                if not attacked and not np.isnan(run.innovation[r, k, c]):
                    nis.append((run.innovation[r, k, c] / run.innovation_std[r, k, c]) ** 2)
                error = (run.attack[r, k, c] - truth.a[r, k, c]) / noise[c]
                if attacked and truth.a[r, k, c] != 0 and not np.isnan(error):
                    miss.append(error**2)
            if not sent or (attacked and not lies):
                continue
            right &= lies == accused
            counts["lies" if lies else "honest"] += 1
            counts["detections" if lies else "false_alarms"] += accused
            if lies:
                first_lie = k if np.isnan(first_lie) else first_lie
                first_find = min(first_find, k) if accused else first_find
        exact.append(right)
    return counts | {
        "mse": float(np.mean(square)),
        "nees": float(np.mean(nees)),
        "nis": float(np.mean(nis)),
        "exact": float(np.mean(exact)),
        "delay": first_find - first_lie,
        "injected": len(miss),
        "injection_error": float(np.mean(miss)) if miss else np.nan,
        "not_ok": float(np.mean(run.status[r, FROM:] != 0)),
    }


def test_every_score_is_what_a_loop_counts() -> None:
    run, truth = met()
    scores = score(run, truth, FROM)
    for r in range(truth.runs):
        want = by_hand(run, truth, r)
        got = dict(zip(PER_RUN, scores.per_run[r], strict=True))
        assert set(got) == set(want)
        for name in want:
            np.testing.assert_allclose(got[name], want[name], rtol=1e-9, err_msg=name)
    square = ((run.x - truth.x) ** 2).sum(axis=2)
    np.testing.assert_allclose(scores.curve, [square.sum(axis=0), (square**2).sum(axis=0)])
    mean, half = error_over_time(scores)
    np.testing.assert_allclose(mean, square.mean(axis=0))
    low, high = stats.t.interval(0.95, truth.runs - 1, loc=mean, scale=stats.sem(square, axis=0))
    np.testing.assert_allclose(half, (high - low) / 2, rtol=1e-6)
    for row, name in zip(scores.per_sensor, PER_SENSOR, strict=True):
        assert row.sum() == scores.per_run[:, PER_RUN.index(name)].sum()


def test_scores_survive_packing_to_the_bit_and_join_in_order() -> None:
    run, truth = met()
    whole = score(run, truth, FROM)
    back = Scores.unpack(whole.pack(), truth.plant.n_sensors, truth.steps)
    for name in ("per_run", "per_sensor", "curve"):
        np.testing.assert_array_equal(getattr(back, name), getattr(whole, name))
    twice = Scores.join([whole, back])
    np.testing.assert_array_equal(twice.per_run, np.vstack([whole.per_run, whole.per_run]))
    np.testing.assert_array_equal(twice.curve, 2 * whole.curve)
    np.testing.assert_array_equal(twice.per_sensor, 2 * whole.per_sensor)


def test_the_kalman_filter_is_consistent_when_nobody_lies() -> None:
    truth = simulate(plant(), 300, runs=60, seed=2)
    run, _ = truth.confront(KalmanFilter(plant()))
    figures = summarise_scores(score(run, truth), None)
    samples = 60 * 300
    # n NEES is chi-square with n degrees of freedom, correlated over about ten samples.
    assert abs(figures["nees"] - 1) < 4 * np.sqrt(2 / (2 * samples / 10))
    assert abs(figures["nis"] - 1) < 4 * np.sqrt(2 / samples)
    assert figures["false_alarm_rate"] == 0
    assert figures["exact_sets"] == 1
    assert all(
        np.isnan(figures[name]) for name in ("detection_rate", "delay", "found", "injection_rms", "ratio")
    )
    P = run.P
    assert P is not None
    assert figures["mse_low"] < float(np.trace(P[0, -1])) < figures["mse_high"]


def test_the_oracle_finds_every_liar_at_once_and_no_other_sensor() -> None:
    truth = simulate(plant(), 60, Bias(30.0, on=Redrawn((1, 2))), runs=20, seed=3)
    run, _ = truth.confront(OracleFilter(plant()))
    figures = summarise_scores(score(run, truth), None)
    names = ("detection_rate", "false_alarm_rate", "delay", "found", "exact_sets")
    assert [figures[name] for name in names] == [1.0, 0.0, 0.0, 1.0, 1.0]
    assert 0.9 < figures["injection_rms"] < 2.0  # noise of the reading, and of the state seen through C


def test_a_liar_that_nobody_suspects_is_never_found() -> None:
    truth = simulate(plant(), 20, Bias(30.0, on=0), runs=3, seed=3)
    run, _ = truth.confront(KalmanFilter(plant()))
    figures = summarise_scores(score(run, truth), None)
    assert (figures["delay"], figures["found"], figures["detection_rate"]) == (np.inf, 0.0, 0.0)


def test_a_suppressed_reading_is_neither_a_lie_nor_honest() -> None:
    truth = simulate(plant(), 20, Denial(on="s1"), runs=2, seed=3)
    run, _ = truth.confront(InnovationGate(plant()))
    counts = dict(zip(PER_SENSOR, score(run, truth).per_sensor, strict=True))
    assert counts["honest"][2] == counts["lies"][2] == counts["detections"][2] == 0
    assert counts["honest"][0] == 40


def test_an_adversary_that_leaves_a_reading_as_it_is_does_not_lie_there() -> None:
    truth = simulate(plant(), 40, Pulse(50.0, every=10, on="s1") + Denial(0.5, on="s2"), runs=3, seed=3)
    run, _ = truth.confront(OracleFilter(plant()))
    counts = dict(zip(PER_SENSOR, score(run, truth).per_sensor, strict=True))
    assert (counts["lies"][2], counts["detections"][2], counts["honest"][2]) == (12, 12, 0)
    assert counts["lies"][3] == counts["honest"][3] == 0
    run, _ = truth.confront(InnovationGate(plant()))
    figures = summarise_scores(score(run, truth), None)
    assert figures["detection_rate"] == 1.0


def test_a_state_beyond_all_numbers_counts_as_infinitely_wrong() -> None:
    run, truth = met(runs=2)
    x = run.x.copy()
    x[0, 20], x[1, 21] = np.nan, 1e200
    figures = summarise_scores(score(replace(run, x=x), truth), None)
    assert figures["mse"] == np.inf


def test_a_singular_covariance_is_never_called_honest() -> None:
    run, truth = met(runs=2)
    assert run.P is not None
    P = run.P.copy()
    P[0, 10] = 0.0
    nees = score(replace(run, P=P, x_std=np.sqrt(np.diagonal(P, axis1=-2, axis2=-1))), truth).per_run[:, 1]
    assert not np.isfinite(nees[0])
    assert np.isnan(score(replace(run, P=None), truth).per_run[:, 1]).all()


def made(mse: Any) -> Scores:
    """Scores of runs with these mean squared errors and nothing else."""
    per_run = np.zeros((len(mse), len(PER_RUN)))
    per_run[:, 0] = mse
    return Scores(per_run, np.zeros((len(PER_SENSOR), 1)), np.zeros((2, 1)))


def test_the_interval_of_the_error_is_students() -> None:
    mse = np.random.default_rng(1).exponential(size=30)
    figures = summarise_scores(made(mse), None)
    low, high = stats.t.interval(0.95, 29, loc=mse.mean(), scale=stats.sem(mse))
    np.testing.assert_allclose([figures["mse_low"], figures["mse_high"]], [low, high])


def test_the_interval_of_the_ratio_covers_as_often_as_it_says() -> None:
    rng, covered = np.random.default_rng(2), 0
    for _ in range(1000):
        common = rng.exponential(size=100)
        oracle, other = common + rng.exponential(size=100), 3 * common + rng.exponential(size=100)
        figures = summarise_scores(made(other), made(oracle))
        covered += figures["ratio_low"] <= 2.0 <= figures["ratio_high"]
    assert 0.92 < covered / 1000 < 0.98


def test_the_ratio_of_equal_errors_is_one_without_doubt() -> None:
    mse = np.random.default_rng(3).exponential(size=10)
    figures = summarise_scores(made(mse), made(mse))
    assert [figures[name] for name in ("ratio_low", "ratio", "ratio_high")] == [1.0, 1.0, 1.0]


def test_a_single_run_has_no_interval() -> None:
    figures = summarise_scores(made([2.0]), made([1.0]))
    assert figures["ratio"] == 2.0
    assert np.isnan(figures["mse_low"])
    assert np.isnan(figures["ratio_high"])


@pytest.mark.parametrize("owners", [[0, 1, 2], [0, 0, 1, 2, 2]])
def test_a_sensor_arrives_if_one_of_its_channels_does(owners: list[int]) -> None:
    channels = np.random.default_rng(1).random((4, 7, len(owners))) < 0.5
    own = np.array(owners)
    expected = np.stack([channels[..., own == i].any(axis=-1) for i in range(3)], axis=-1)
    np.testing.assert_array_equal(per_sensor(channels, own, 3), expected)

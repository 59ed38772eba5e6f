from dataclasses import replace

import numpy as np
import pytest

from securestate import Plant, Sensor
from securestate.errors import InputError
from securestate.estimators.run import Run
from securestate.reporting import summarise
from tests.reporting.made_runs import SHIFT, lie, made_lies, made_run, unchecked, with_silence


def flagged(samples: list[int], length: int = 200) -> Run:
    """A run in which the first sensor is suspected at exactly these samples."""
    run = made_run(samples=length)
    suspected = np.zeros_like(run.suspected)
    suspected[samples, 0] = True
    return replace(run, suspected=suspected)


def test_the_verdict_names_every_liar_and_counts_all_sensors() -> None:
    assert summarise(made_run(liars=(1, 3))).verdict == "2 of 5 sensors lie: XMEAS 2 and XMEAS 4."
    assert summarise(made_run(liars=(1,))).verdict == "1 of 5 sensors lies: XMEAS 2."


def test_a_majority_is_a_matter_of_the_plant_and_not_of_liars() -> None:
    verdict = summarise(made_run(liars=(0, 1, 3))).verdict
    assert verdict.startswith(
        "3 of 5 sensors contradict the plant, too many to blame them: check its matrices"
    )


def test_protected_sensors_may_convict_a_majority() -> None:
    run = made_run(liars=(0, 1, 2))
    marked = [replace_protected(sensor, i > 2) for i, sensor in enumerate(run.plant.sensors)]
    plant = Plant(run.plant.A, run.plant.Q, marked)
    judged = summarise(replace(run, plant=plant, estimator="AdaptiveJointFilter")).verdict
    assert judged.startswith("3 of 5 sensors lie")
    assert "contradict" in summarise(replace(run, plant=plant, estimator="SparseFusion")).verdict
    nobody = Plant(plant.A, plant.Q, [replace_protected(sensor, False) for sensor in plant.sensors])
    assert "contradict" in summarise(replace(run, plant=nobody, estimator="AdaptiveJointFilter")).verdict


def replace_protected(sensor: Sensor, protected: bool) -> Sensor:
    return Sensor(sensor.name, C=sensor.C, R=sensor.R, protected=protected, channels=sensor.channels)


def test_a_filter_that_trusts_everybody_says_so() -> None:
    run = replace(made_run(), estimator="KalmanFilter")
    assert summarise(run).verdict == "KalmanFilter trusts every sensor: it does not look for liars."


def test_a_quiet_run_has_no_suspect() -> None:
    summary = summarise(made_run())
    assert summary.verdict == "No sensor is suspected."
    assert summary.liars == ()
    assert all(s.first_alarm is None and s.suspected == 0 for s in summary.sensors)


def test_share_first_alarm_and_injection_of_a_liar_are_those_made() -> None:
    time = np.arange(300) * 180.0
    liar = summarise(made_run(liars=(1,), since=75, time=time)).sensors[1]
    assert liar.suspected == 0.75
    assert liar.first_alarm is not None
    assert (liar.first_alarm.index, liar.first_alarm.time) == (75, 75 * 180.0)
    (injection,) = liar.injections
    assert (injection.channel, injection.unit) == ("XMEAS 2", "kPa")
    assert injection.median == pytest.approx(SHIFT, abs=0.15)
    assert injection.spread == pytest.approx(0.5, abs=0.1)


def test_without_times_the_first_alarm_has_an_index_only() -> None:
    alarm = summarise(made_run(liars=(1,), since=75)).sensors[1].first_alarm
    assert alarm is not None
    assert (alarm.index, alarm.time) == (75, None)


def test_dates_stay_dates() -> None:
    time = np.datetime64("2024-03-01", "ns") + np.arange(300) * np.timedelta64(180, "s")
    alarm = summarise(made_run(liars=(1,), since=20, time=time)).sensors[1].first_alarm
    assert alarm is not None
    assert alarm.time == np.datetime64("2024-03-01T01:00", "ns")


def test_nine_alarms_of_twenty_samples_are_isolated_and_ten_are_a_lie() -> None:
    nine, ten = summarise(flagged(list(range(50, 68, 2)))), summarise(flagged(list(range(50, 70, 2))))
    assert (nine.liars, ten.liars) == ((), ("XMEAS 1",))
    assert nine.verdict == "No sensor lies persistently; there are brief alarms of XMEAS 1."
    four = summarise(flagged([50, 52, 54, 56]))
    assert four.verdict == "No sensor lies persistently; there are isolated alarms."


def test_a_lie_is_dated_from_its_stretch_not_from_an_earlier_isolated_alarm() -> None:
    sensor = summarise(flagged([5, *range(100, 140)])).sensors[0]
    assert sensor.first_alarm is not None
    assert sensor.since is not None
    assert (sensor.first_alarm.index, sensor.since.index) == (5, 100)


def test_silence_between_suspected_samples_does_not_hide_a_lie() -> None:
    run = flagged(list(range(0, 200, 10)))
    for array in (run.trust, run.innovation, run.attack):
        array[~run.suspected[:, 0], 0] = np.nan
    assert summarise(run).liars == ("XMEAS 1",)


def test_a_run_shorter_than_the_window_is_judged_on_what_it_has() -> None:
    assert summarise(made_run(samples=4, liars=(0,), since=2)).liars == ("XMEAS 1",)
    assert summarise(made_run(samples=4, liars=(0,), since=3)).liars == ()


def test_a_silent_sensor_is_missing_and_never_a_liar() -> None:
    sensor = summarise(with_silence(made_run(liars=(1,)), 1, slice(None))).sensors[1]
    assert (sensor.missing, sensor.suspected, sensor.lies) == (1.0, 0.0, False)


def test_an_estimator_without_injections_gives_nan_and_no_warning() -> None:
    run = made_run(liars=(1,))
    sensor = summarise(replace(run, attack=np.full_like(run.attack, np.nan))).sensors[1]
    assert np.isnan(sensor.injections[0].median)
    assert np.isnan(sensor.injections[0].spread)


def test_solver_figures_are_of_the_samples_that_needed_the_solver() -> None:
    summary = summarise(made_run(liars=(1,), since=75))
    assert (summary.fast_path, summary.iterations, summary.gap) == (0.25, 7.0, 1e-12)
    bare = summarise(replace(made_run(), diagnostics={}))
    assert (bare.fast_path, bare.iterations, bare.gap) == (None, None, None)


def test_statuses_are_counted_with_their_advice() -> None:
    status = np.zeros(300, dtype=np.uint8)
    status[:7] = 2
    counts = summarise(replace(made_run(), status=status)).statuses
    assert [(s.name, s.count) for s in counts] == [("OK", 293), ("NOT_CONVERGED", 7)]
    assert "gap" in counts[1].advice


def test_a_batch_is_refused_by_name() -> None:
    with pytest.raises(InputError) as caught:
        summarise(replace(made_run(), x=np.zeros((2, 300, 3))))
    assert caught.value.argument == "run"
    assert "(2, 300, 3)" in caught.value.received


@pytest.mark.parametrize(
    ("sensors", "said"),
    [
        ((), ""),
        ((1,), "1 of 5 sensors cannot be checked: no other sensor vouches for it."),
        ((0, 1, 2), "3 of 5 sensors cannot be checked: no other sensor vouches for them."),
        (
            (1, 4),
            "1 of 5 sensors cannot be checked: no other sensor vouches for it.",
        ),  # the last is protected
    ],
)
def test_it_is_said_how_many_sensors_cannot_be_checked(sensors: tuple[int, ...], said: str) -> None:
    assert summarise(unchecked(made_run(), sensors)).caveat == said


def test_a_sensor_that_cannot_be_checked_is_no_missing_sensor() -> None:
    silent = with_silence(unchecked(made_run(), (0, 1)), 0, slice(0, 30))
    assert [s.missing for s in summarise(silent).sensors] == [0.1, 0.0, 0.0, 0.0, 0.0]


def test_alarms_of_a_sensor_that_cannot_be_checked_count_like_those_of_any_other() -> None:
    for samples in ([50], list(range(50, 200, 3)), list(range(50, 60))):
        plain = summarise(flagged(samples)).sensors[0]
        assert replace(summarise(unchecked(flagged(samples), (0,))).sensors[0], uncheckable=False) == plain


def test_faint_alarms_are_no_lie_and_are_told() -> None:
    made = made_lies({1: lie(100, 160)}, rate=1e-3)
    run = replace(made, attack=np.where(made.suspected, 1.5, 0.0), estimator="SecureFilter")
    summary = summarise(run)
    assert summary.liars == ()
    assert summary.verdict == "No sensor lies persistently; there are faint alarms of XMEAS 2."

"""Findings tell who lied, from when to when, how much and how surely, and what chance explains is none."""

from dataclasses import replace

import numpy as np
import pytest

from securestate import Plant, Sensor
from securestate.errors import InputError
from securestate.estimators.base import Status
from securestate.estimators.run import Run
from securestate.reporting import find
from securestate.reporting.clock import Clock
from securestate.reporting.courses import Kind
from securestate.reporting.findings import Finding
from securestate.reporting.telling import remarks, what
from tests.reporting.made_runs import SHIFT, lie, made_lies, made_run, with_silence

RATE = 1e-3


def test_a_clean_run_has_no_finding() -> None:
    findings = find(made_lies({}, rate=RATE))
    assert (findings.found, findings.crowds, findings.periods) == ((), (), ())
    assert (findings.alarms.count, findings.alarms.at_start, findings.alarms.frequent) == (0, (), ())
    assert findings.alarms.expected == pytest.approx(4 * 400 * RATE)  # the fifth is protected


def test_a_constant_bias_is_told_with_when_how_much_and_how_sure() -> None:
    (one,) = find(made_lies({1: lie(160, 400)}, rate=RATE)).found
    assert (one.sensor, one.since.index, one.until.index, one.ongoing) == ("XMEAS 2", 160, 399, True)
    assert (one.suspected, one.sent, one.lies) == (240, 240, True)
    assert one.expected == pytest.approx(0.24)
    assert one.trust == pytest.approx(0.05) and one.certainty == pytest.approx(0.95)
    (course,) = one.courses
    assert course.kind is Kind.CONSTANT and (course.channel, course.unit) == ("XMEAS 2", "kPa")
    assert course.last == pytest.approx(SHIFT, abs=0.1) and course.spread == pytest.approx(0.5, abs=0.1)
    assert course.error == 0.5


def test_a_ramp_grows() -> None:
    ramp = np.where(np.arange(400) >= 100, 0.2 * np.arange(-100, 300), np.nan)
    (one,) = find(made_lies({0: ramp})).found
    assert one.courses[0].kind is Kind.GROWING
    assert one.courses[0].slope == pytest.approx(0.2, rel=0.02)


def test_an_intermittent_liar_is_one_finding_with_its_share() -> None:
    on_off = lie(100, 300)
    on_off[np.random.default_rng(7).random(400) < 0.4] = np.nan
    (one,) = find(made_lies({2: on_off}, rate=RATE)).found
    assert one.lies and not one.ongoing
    assert 0.5 < one.suspected / one.sent < 0.7
    assert 0.3 < one.trust < 0.5  # it was trusted in between


def test_a_sensor_that_lies_twice_has_two_findings_the_larger_first() -> None:
    both = np.where(np.isnan(lie(50, 120)), lie(250, 320, size=3 * SHIFT), lie(50, 120))
    first, second = find(made_lies({3: both})).found
    assert (first.since.index, second.since.index) == (250, 50)
    assert find(made_lies({3: both})).of("XMEAS 4") == (first, second)


def test_when_all_sensors_jump_nobody_is_blamed() -> None:
    everybody = {i: lie(200, 260) for i in range(5)}
    findings = find(made_lies(everybody, rate=RATE))
    assert all(f.persistent and f.together and not f.lies for f in findings.found)
    (crowd,) = findings.crowds
    assert (crowd.since.index, crowd.until.index, len(crowd.sensors)) == (200, 259, 5)
    brief = find(made_lies({i: lie(200, 202) for i in range(5)}, rate=RATE))
    assert (brief.found, brief.alarms.count, len(brief.crowds)) == ((), 0, 1)
    assert not brief.crowds[0].persistent


def test_a_jump_at_the_first_sample_blames_nobody_either() -> None:
    findings = find(made_lies({i: lie(0, 30) for i in range(5)}))
    assert not any(f.lies for f in findings.found) and findings.crowds[0].since.index == 0


def test_a_minority_that_lies_before_others_do_is_blamed_all_the_same() -> None:
    """Three of five lie in all, but never at the same time."""
    findings = find(made_lies({0: lie(20, 120), 1: lie(140, 240), 3: lie(260, 360)}))
    assert all(f.lies for f in findings.found) and findings.crowds == ()


def test_alarms_beside_a_liar_are_no_crowd() -> None:
    findings = find(made_lies({0: lie(50, 400), 1: lie(90, 91), 2: lie(90, 91)}, rate=RATE))
    assert [f.sensor for f in findings.found] == ["XMEAS 1"]
    crowd = find(made_lies({0: lie(50, 400), 1: lie(90, 91)}, rate=RATE))
    assert (crowd.crowds, crowd.alarms.count) == ((), 1)


def test_alarms_that_chance_explains_are_counted_against_the_stated_rate() -> None:
    rng = np.random.default_rng(8)
    noise = {i: np.where(rng.random(20_000) < RATE, 7.0, np.nan) for i in range(4)}
    findings = find(made_lies(noise, 20_000, rate=RATE))
    alarms = findings.alarms
    assert findings.found == () and alarms.frequent == ()
    assert alarms.expected == pytest.approx(80, rel=0.01) and 55 < alarms.count < 105
    assert find(made_lies(noise, 20_000)).alarms.expected is None


@pytest.mark.parametrize("rate", [RATE, None])
def test_five_alarms_in_a_row_are_more_than_chance_explains_and_three_are_not(rate: float | None) -> None:
    (one,) = find(made_lies({1: lie(100, 105)}, rate=rate)).found
    assert not one.persistent and not one.lies and one.suspected == 5
    assert find(made_lies({1: lie(100, 103)}, rate=rate)).found == ()
    assert find(made_lies({1: lie(100, 105)}, rate=0.1)).found == ()


def test_alarms_that_come_in_clusters_from_all_sensors_are_no_findings() -> None:
    """A method with a memory errs as often as it says, but several times in a row."""
    rng = np.random.default_rng(9)
    clusters = {i: np.full(20_000, np.nan) for i in range(4)}
    for values in clusters.values():
        for start in rng.choice(19_900, 4, replace=False):
            values[start : start + min(8, rng.geometric(1 / 5))] = 7.0
    findings = find(made_lies(clusters, 20_000, rate=RATE))
    assert findings.found == () and findings.alarms.count > 50


def test_one_sensor_with_a_brief_lie_again_and_again_is_found_all_the_same() -> None:
    pulses = np.full(4000, np.nan)
    for start in range(100, 3900, 200):
        pulses[start : start + 6] = 9.0
    assert len(find(made_lies({1: pulses}, 4000, rate=RATE)).found) == 19


def test_a_sensor_with_many_scattered_alarms_is_pointed_at() -> None:
    scattered = np.full(4000, np.nan)
    scattered[50::100] = 7.0
    findings = find(made_lies({2: scattered}, 4000, rate=RATE))
    assert findings.found == () and findings.alarms.frequent == (("XMEAS 3", 40),)


def test_what_is_lost_in_its_scatter_or_brief_does_not_head_the_list() -> None:
    added = {0: lie(50, 350, size=0.01), 1: lie(100, 180, size=4.0), 2: lie(200, 206, size=90.0)}
    added[3] = lie(20, 60, size=8.0)
    assert [f.sensor for f in find(made_lies(added, rate=RATE)).found] == [
        "XMEAS 4",
        "XMEAS 2",
        "XMEAS 1",
        "XMEAS 3",
    ]


def test_the_less_trusted_comes_first_even_if_it_adds_less() -> None:
    run = made_lies({0: lie(50, 150, size=30.0), 1: lie(50, 150, size=8.0)})
    run.trust[run.suspected[:, 0], 0] = 0.45
    assert [f.sensor for f in find(run).found] == ["XMEAS 2", "XMEAS 1"]


@pytest.mark.parametrize("cold", [False, True])
def test_the_start_is_told_apart(cold: bool) -> None:
    run = made_lies({0: lie(0, 9 if not cold else 26), 1: lie(100, 200)})
    run.status[: 26 if cold else 0] = Status.COLD_START
    findings = find(run)
    assert [f.sensor for f in findings.found] == ["XMEAS 2"]
    assert findings.alarms.settled == (26 if cold else 10)
    assert findings.alarms.at_start == (("XMEAS 1", 26 if cold else 9),)
    assert findings.alarms.count == 0


def test_a_lie_from_the_first_sample_on_is_no_start() -> None:
    (one,) = find(made_lies({0: lie(0, 200)})).found
    assert (one.since.index, one.until.index) == (0, 199)


def test_missing_samples_do_not_count_and_trust_is_of_those_that_arrived() -> None:
    run = with_silence(made_lies({1: lie(100, 300)}), 1, slice(150, 200))
    (one,) = find(run).found
    assert (one.since.index, one.until.index, one.suspected, one.sent) == (100, 299, 150, 150)
    assert one.trust == pytest.approx(0.05)


def test_without_any_trust_the_share_of_suspected_samples_tells_how_sure() -> None:
    run = made_lies({1: lie(100, 300)})
    (one,) = find(replace(run, trust=np.full_like(run.trust, np.nan))).found
    assert np.isnan(one.trust) and one.certainty == 1.0


def test_every_channel_of_a_sensor_has_its_course() -> None:
    pair = Sensor("pair", np.eye(2), 1.0, unit=["m", "m/s"])
    others = [Sensor(name, np.eye(2)[:1], 1.0) for name in ("a", "b", "c")]
    run = vector_run(Plant(0.9 * np.eye(2), np.eye(2), [pair, *others]))
    (one,) = find(run).found
    assert [(c.channel, c.unit, c.kind) for c in one.courses] == [
        ("pair.1", "m", Kind.CONSTANT),
        ("pair.2", "m/s", Kind.UNKNOWN),
    ]
    assert one.courses[0].last == pytest.approx(5.0) and not one.courses[1].known
    assert one.size == pytest.approx(5.0) and one.clear


def vector_run(plant: Plant) -> Run:
    """A sensor of two channels is suspected from sample 20 on; of the second there is no estimate."""
    base = made_run(sensors=4, samples=100)
    suspected = np.zeros((100, 4), dtype=bool)
    suspected[20:, 0] = True
    attack = np.zeros((100, 5))
    attack[20:, :2] = 5.0, np.nan
    wide = np.ones((100, 5))
    return replace(
        base,
        plant=plant,
        suspected=suspected,
        attack=attack,
        attack_std=np.full((100, 5), np.nan),
        innovation=wide,
        innovation_std=wide,
    )


def test_one_sample_is_enough() -> None:
    assert find(made_lies({}, 1)).found == ()
    (one,) = find(made_lies({0: lie(0, 1, samples=1)}, 1)).found
    assert (one.suspected, one.sent, one.ongoing, one.lies) == (1, 1, True, True)


def test_methods_in_which_protected_sensors_judge_may_blame_a_majority() -> None:
    run = replace(made_lies({i: lie(50, 300) for i in range(4)}), estimator="JointFusion")
    assert len(find(run).found) == 4 and all(f.lies for f in find(run).found)


def test_with_a_protected_sensor_all_others_may_be_blamed_by_the_secure_filter() -> None:
    run = replace(made_lies({i: lie(50, 300) for i in range(4)}), estimator="SecureFilter")
    assert run.plant.protected.tolist() == [False] * 4 + [True]
    assert len(find(run).found) == 4 and all(f.lies for f in find(run).found)


def test_a_method_that_remembers_blames_for_what_stands_out_or_lasts() -> None:
    """An injection of 3 errors, each of 0.5 kPa, as one that an honest sensor may be taken to have."""

    def found(stop: int, size: float, estimator: str = "SecureFilter") -> Finding:
        made = made_lies({1: lie(100, stop)}, rate=RATE)
        attack = np.where(made.suspected, size * 0.5, made.attack)
        (one,) = find(replace(made, attack=attack, estimator=estimator)).found
        return one

    faint = found(160, 3.0)
    assert (faint.verdict, faint.persistent, faint.lies, faint.suspected) == ("faint", True, False, 60)
    assert "raised 60 alarms" in what(faint, Clock.of(made_lies({})))
    assert "too faint to say that it lies" in what(faint, Clock.of(made_lies({})))
    assert "by chance" not in what(faint, Clock.of(made_lies({})))
    assert found(160, 7.0).verdict == found(300, 3.0).verdict == "lied"
    assert found(160, 3.0, "InnovationGate").verdict == "lied"


def test_what_a_filter_with_a_memory_makes_of_a_far_start_blames_nobody() -> None:
    run = replace(made_lies({1: lie(0, 50)}, rate=RATE), estimator="SecureFilter")
    findings = find(run)
    assert findings.found == () and findings.alarms.at_start == (("XMEAS 2", 50),)
    assert "for a while XMEAS 2 was suspected, as may happen" in next(remarks(findings.alarms))
    assert "--prior window" in next(remarks(findings.alarms))
    started = replace(run, status=np.where(np.arange(400) < 4, Status.COLD_START, 0).astype(np.uint8))
    assert find(started).found[0].lies and find(replace(run, estimator="InnovationGate")).found[0].lies
    lasting = replace(made_lies({1: lie(0, 300)}, rate=RATE), estimator="SecureFilter")
    assert find(lasting).found[0].lies


def test_the_rate_of_a_test_of_all_sensors_at_once_is_no_rate_of_one() -> None:
    run = replace(made_lies({}), settings={"false_alarm_rate": 0.01, "scope": "central"})
    assert find(run).alarms.rate is None


def test_a_status_has_its_stretches_and_says_what_to_do() -> None:
    run = made_lies({})
    run.status[[50, 51, 52, 60, 200]] = Status.AMBIGUOUS
    run.status[300:350] = Status.NO_MEASUREMENT
    quiet, unclear = find(run).periods
    assert (quiet.status, quiet.samples) == ("NO_MEASUREMENT", 50)
    assert "check the connection" in quiet.meaning
    assert [(a.index, b.index) for a, b in unclear.stretches] == [(50, 60), (200, 200)]
    assert unclear.longest[0].index == 50 and "two ways" in unclear.meaning


def test_a_batch_is_refused_by_name() -> None:
    with pytest.raises(InputError, match=r"^run: "):
        find(replace(made_run(), x=np.zeros((2, 300, 3))))

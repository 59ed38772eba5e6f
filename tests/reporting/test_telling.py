"""Findings in sentences: every number that matters, and what to do."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from securestate.estimators.run import Run
from securestate.reporting import find, write_findings
from securestate.reporting.clock import Clock
from securestate.reporting.telling import TOLD, period, plain_signs, sentences
from tests.reporting.made_runs import lie, made_lies, made_run

RATE = 1e-3


def told(run: Run) -> list[str]:
    return list(sentences(find(run), Clock.of(run)))


def test_a_lie_is_told_with_since_when_how_much_and_how_sure() -> None:
    time = np.datetime64("2024-03-01", "ns") + np.arange(400) * np.timedelta64(180, "s")
    (one,) = told(replace(made_lies({1: lie(160, 400)}, rate=RATE), time=time))
    assert one.startswith(
        "XMEAS 2 lies since 2024-03-01 08:00 (sample 160), still at the end: about +11.99 ± 0.5"
    )
    assert one.endswith("kPa, constant; suspected in 240 of 240 samples, 0.24 by chance, mean trust 0.05.")


def test_a_method_that_states_no_rate_or_no_trust_is_told_without() -> None:
    run = made_lies({1: lie(160, 300)})
    (one,) = told(replace(run, trust=np.full_like(run.trust, np.nan)))
    assert "from 8.00 h to 14.95 h (samples 160 to 299)" in one
    assert one.endswith("constant; suspected in 140 of 140 samples.")


def test_a_method_that_estimates_no_injection_tells_the_rest() -> None:
    run = made_lies({1: lie(160, 300)})
    (one,) = told(replace(run, attack=np.full_like(run.attack, np.nan)))
    assert one == (
        "XMEAS 2 lied from 8.00 h to 14.95 h (samples 160 to 299): suspected in 140 of 140 samples, "
        "mean trust 0.05."
    )


def test_a_brief_episode_is_told_as_such() -> None:
    (one,) = told(made_lies({1: lie(100, 106)}, rate=RATE))
    assert one.startswith(
        "XMEAS 2 raised 6 alarms from 5.00 h to 5.25 h (samples 100 to 105), too few to say"
    )


def test_a_jump_of_all_sensors_is_told_once_and_without_blame() -> None:
    (one,) = told(made_lies({i: lie(200, 260) for i in range(5)}, rate=RATE))
    assert one.startswith("From 10.00 h to 12.95 h (samples 200 to 259) 5 sensors contradict")
    assert "too many to say who lies" in one
    (short,) = told(made_lies({i: lie(200, 201) for i in range(5)}, rate=RATE))
    assert short.startswith("At 10.00 h (sample 200) 5 sensors") and "jump of the plant" in short


@pytest.mark.parametrize(
    ("every", "how"), [(1000, "about as many as"), (100, "more than"), (5000, "fewer than")]
)
def test_isolated_alarms_are_compared_with_the_stated_rate(every: int, how: str) -> None:
    alarms = {i: np.full(10_000, np.nan) for i in range(4)}
    for i, values in alarms.items():
        values[50 + 20 * i :: every] = 7.0
    (line,) = (each for each in told(made_lies(alarms, 10_000, rate=RATE)) if "isolated" in each)
    assert f"{how} the stated rate of 0.1 % leads to expect (40)" in line


def test_of_many_findings_the_last_are_only_counted() -> None:
    many = {0: np.full(4000, np.nan)}
    for k in range(TOLD + 3):
        many[0][100 + 200 * k : 140 + 200 * k] = 10.0
    said = told(made_lies(many, 4000))
    assert len(said) == TOLD + 1 and said[-1] == "And 3 further findings, each smaller or less certain."


def test_a_status_is_told_with_its_longest_stretch_and_what_to_do() -> None:
    run = made_run(samples=300)
    run.status[100:120] = run.status[200] = 5
    (one,) = find(run).periods
    assert period(one, Clock.of(run)) == (
        "AMBIGUOUS in 21 samples, 2 stretches, the longest from 5.00 h to 5.95 h (samples 100 to 119): two "
        "ways to say who lies explain the readings about equally well; do not act on a name from this time "
        "before somebody has looked at the sensors."
    )


def test_terminals_get_a_hyphen_for_minus() -> None:
    assert plain_signs("−15.0 ± 0.4") == "-15.0 ± 0.4"


def test_the_file_for_programs_is_plain_json_with_null_for_what_is_unknown(tmp_path: Path) -> None:
    run = made_lies({1: lie(160, 400), 2: lie(100, 101)}, rate=RATE)
    run = replace(run, attack=np.full_like(run.attack, np.nan), trust=np.full_like(run.trust, np.nan))
    run.status[:3] = 7
    path = write_findings(run, tmp_path / "findings.json", source="a.csv")
    found = json.loads(path.read_text(encoding="utf-8"), parse_constant=pytest.fail)
    (one,) = found["findings"]
    assert (one["sensor"], one["trust"], one["injections"][0]["size"]) == ("XMEAS 2", None, None)
    assert (one["since"], one["verdict"]) == ({"sample": 160, "time": None}, "lies")
    assert (found["liars"], found["alarms"]["count"], found["source"]) == (["XMEAS 2"], 1, "a.csv")
    assert found["periods"][0]["stretches"] == [[{"sample": 0, "time": None}, {"sample": 2, "time": None}]]


def test_times_in_the_file_for_programs_are_seconds_or_iso_8601(tmp_path: Path) -> None:
    run = made_lies({1: lie(160, 400)})
    seconds = replace(run, time=180.0 * np.arange(400))
    dates = replace(run, time=np.datetime64("2024-03-01", "ns") + np.arange(400) * np.timedelta64(180, "s"))
    read = [
        json.loads(write_findings(each, tmp_path / "f.json").read_text())["findings"][0]["since"]["time"]
        for each in (seconds, dates)
    ]
    assert read == [28_800.0, "2024-03-01T08:00"]

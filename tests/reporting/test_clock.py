from dataclasses import replace

import numpy as np
import pytest

from securestate.reporting.clock import Clock
from tests.reporting.made_runs import made_plant, made_run


@pytest.mark.parametrize(
    ("step", "unit", "last"),
    [(0.01, "s", "2.99 s"), (3.0, "min", "14.95 min"), (180.0, "h", "14.95 h"), (86400.0, "d", "299 d")],
)
def test_the_unit_fits_the_span(step: float, unit: str, last: str) -> None:
    clock = Clock.of(made_run(time=np.arange(300) * step))
    assert (clock.unit, clock.text(299)) == (unit, last)


def test_without_times_the_sample_time_of_the_plant_counts() -> None:
    assert Clock.of(made_run()).span == "0.00 h to 14.95 h"


def test_without_times_and_with_sample_time_one_samples_are_counted() -> None:
    run = replace(made_run(), plant=made_plant(3, 5, dt=1.0))
    assert Clock.of(run).span == "sample 0 to sample 299"


def test_dates_are_iso_and_show_seconds_only_if_there_are_any() -> None:
    start = np.datetime64("2024-02-29T23:58:00", "ns")
    minutes = Clock.of(made_run(time=start + np.arange(300) * np.timedelta64(60, "s")))
    seconds = Clock.of(made_run(time=start + np.arange(300) * np.timedelta64(1, "s")))
    assert minutes.text(2) == "2024-03-01 00:00"
    assert seconds.text(59) == "2024-02-29 23:58:59"


def test_a_single_gap_makes_times_irregular() -> None:
    time = np.arange(300.0)
    assert Clock.of(made_run(time=time)).regular == (0.0, 1.0)
    time[150:] += 5
    assert Clock.of(made_run(time=time)).regular is None

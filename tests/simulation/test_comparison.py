"""What a comparison says of itself: ranking, tables, figures, names."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import securestate as ss
from securestate.attacks import Bias, Freeze
from securestate.simulation import Comparison, Recipe, Scenario, campaign, compare
from securestate.simulation.comparison import MEANING
from tests.reporting.made_comparisons import made_comparison
from tests.simulation.campaigns import FAMILY, PLANT


@pytest.fixture(scope="module")
def result() -> Comparison:
    attacks = {"nobody": None, "bias": Bias(20.0, on="b", start=5)}
    return compare(PLANT, ["kalman", "gate"], attacks, runs=12, steps=30, seed=2, score_from=5)


def test_who_runs_in_fewer_scenarios_stands_below() -> None:
    ranking = made_comparison({"picky": [1.0, "no"], "steady": [2.0, 8.0]}).ranking
    assert list(ranking.index) == ["oracle", "steady", "picky"]
    np.testing.assert_allclose(ranking["ratio"], [1.0, 4.0, 1.0])
    assert list(ranking["scenarios"]) == [2, 2, 1]
    np.testing.assert_allclose(ranking["within"], [1.0, 0.0, 0.5])
    np.testing.assert_allclose(ranking["worst"], [1.0, 8.0, 1.0])


def test_who_diverges_once_has_an_infinite_mean() -> None:
    ranking = made_comparison({"lost": [1.0, np.inf], "steady": [9.0, 9.0]}).ranking
    assert list(ranking.index) == ["oracle", "steady", "lost"]
    assert np.isinf(ranking.loc["lost", "ratio"])


def test_every_variable_has_its_meaning_and_every_pair_its_row(result: Comparison) -> None:
    for name, text in MEANING.items():
        assert result.table[name].attrs["long_name"] == text
    frame = result.to_pandas()
    assert list(frame.columns[:4]) == ["scenario", "plant", "attack", "estimator"]
    assert len(frame) == 6
    assert set(MEANING) <= set(frame.columns)
    assert repr(result) == "Comparison(2 scenarios × 3 estimators)"


def test_the_saved_files_hold_the_same_numbers(result: Comparison, tmp_path: Path) -> None:
    paths = result.save(tmp_path / "new" / "folder")
    assert [path.name for path in paths] == ["table.nc", "table.csv", "sensors.csv", "timing.csv"]
    with xr.open_dataset(paths[0], engine="h5netcdf") as table:
        np.testing.assert_array_equal(table.squared_error.values, result.table.squared_error.values)
    np.testing.assert_array_equal(pd.read_csv(paths[1])["mse"], result.to_pandas()["mse"])
    sensors = pd.read_csv(paths[2])
    assert len(sensors) == 6 * 5
    lies = sensors[(sensors.scenario == "bias") & (sensors.estimator == "gate")].set_index("sensor")["lies"]
    assert lies.to_dict() == {"a": 0, "b": 12 * 25, "c": 0, "d": 0, "e": 0}


def test_the_figures_show_the_tables_numbers(result: Comparison) -> None:
    (heat,) = result.plot().data
    np.testing.assert_allclose(heat.z, np.log10(np.clip(result.table.ratio.values, 1, 100)))
    assert list(heat.x) == ["oracle", "kalman", "gate"]
    assert heat.text[1][1] == f"{float(result.table.ratio[1, 1]):.3g}"
    lines = result.plot_errors("bias").data
    assert [line.name for line in lines] == ["oracle", "kalman", "gate"]
    np.testing.assert_array_equal(lines[2].y, result.table.squared_error[1, 2].values)
    with pytest.raises(ss.InputError, match="scenario: expected one of nobody, bias, received 'lies'"):
        result.plot_errors("lies")


def test_the_error_over_time_is_the_mean_squared_error(result: Comparison) -> None:
    scored = result.table.squared_error.sel(time=slice(5, None)).mean("time")
    np.testing.assert_allclose(scored, result.table.mse)


def test_a_list_of_attacks_and_several_plants_get_names() -> None:
    attacks = [None, Bias(1.0, on=0), Bias(2.0, on=0), Bias(1.0, on=0) + Freeze(on=1, start=1)]
    one = compare(PLANT, ["kalman"], attacks, runs=1, steps=5, seed=1)
    assert list(one.table.scenario.values) == ["none", "Bias 2", "Bias 3", "Bias + Freeze"]
    assert list(one.table.plant.values) == ["five"] * 4
    several = compare({"fixed": PLANT, "drawn": FAMILY}, ["kalman"], [None], runs=1, steps=5, seed=1)
    assert list(several.table.scenario.values) == ["fixed: none", "drawn: none"]
    assert list(several.table.attacked.values) == [False, False]


def test_scenarios_of_different_lengths_share_a_table() -> None:
    both = [Scenario(f"{steps}", PLANT, None, steps, 10, seed=1) for steps in (10, 20)]
    table = campaign(both, [Recipe("k", ss.KalmanFilter)]).table
    assert table.sizes == {"scenario": 2, "estimator": 2, "time": 20}
    assert np.isfinite(table.squared_error.values[0, :, :10]).all()
    assert np.isnan(table.squared_error.values[0, :, 10:]).all()
    np.testing.assert_array_equal(table.squared_error[0, :, :10], table.squared_error[1, :, :10])
    assert list(table.steps.values) == [10, 20]

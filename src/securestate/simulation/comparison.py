"""The result of a comparison: a labelled table, what each sensor saw, who could not run and why."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import numpy as np
from numpy.typing import NDArray

from securestate._files import whole_file
from securestate.simulation.metrics import PER_SENSOR, Scores, error_over_time, summarise_scores
from securestate.simulation.scenario import Recipe, Scenario

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

Float = NDArray[np.float64]

#: Variables of the table and what they are.
MEANING: Mapping[str, str] = {
    "mse": "mean over runs and scored samples of the squared error of the state",
    "mse_low": "lower end of its 95 % interval",
    "mse_high": "upper end of its 95 % interval",
    "ratio": "mse over the oracle's on the same runs",
    "ratio_low": "lower end of its 95 % interval",
    "ratio_high": "upper end of its 95 % interval",
    "nees": "mean normalised estimation error squared over n; 1 if P is honest",
    "nis": "mean normalised innovation squared of honest channels; 1 if nobody lies and the model holds",
    "false_alarm_rate": "share of honest readings whose sensor was suspected",
    "detection_rate": "share of falsified readings whose sensor was suspected",
    "delay": "median over runs of the samples from the first lie to a liar suspected; inf: most never",
    "found": "share of runs with a lie in which a liar was ever suspected",
    "exact_sets": "share of samples in which exactly the liars were suspected",
    "injection_rms": "root mean square error of the estimated injections, in noise standard deviations",
    "not_ok": "share of samples whose status is not OK",
    "runs": "number of runs",
}


@dataclass(frozen=True)
class Cell:
    """One estimator in one scenario: scores, or why it could not run; microseconds per step of one filter."""

    scores: Scores | None
    refusal: str
    microseconds: float


@final
@dataclass(frozen=True, eq=False)
class Comparison:
    """Estimators against adversaries, on the same runs.

    Attributes:
        table: xarray Dataset over (scenario, estimator) with the variables of `MEANING`, `refusal` (empty, or
            why an estimator could not run) and, over time (scenario, estimator, time), `squared_error`, the
            mean over runs, and `squared_error_half`, half the width of its 95 % interval. Coordinates
            `plant`, `attack`, `attacked` (whether there is an adversary at all), `attack_from` (its first
            sample, -1 if there is none), `steps`, `score_from` and `seed` of the scenarios. The same for any
            number of workers, to the bit.
        sensors: pandas DataFrame, one row per scenario, estimator and sensor: counts and rates.
        timing: pandas DataFrame (scenario, estimator), microseconds per step of one filter on one thread, the
            fastest of a few; it depends on the machine and its load.
    """

    table: xr.Dataset
    sensors: pd.DataFrame
    timing: pd.DataFrame

    @staticmethod
    def of(
        scenarios: Sequence[Scenario], recipes: Sequence[Recipe], cells: Mapping[tuple[str, str], Cell]
    ) -> Comparison:
        """Put cells in order; the first recipe is the oracle."""
        import pandas as pd

        names = [recipe.name for recipe in recipes]
        timing = [[cells[s.name, name].microseconds for name in names] for s in scenarios]
        index = pd.Index([s.name for s in scenarios], name="scenario")
        columns = pd.Index(names, name="estimator")
        return Comparison(
            _table(scenarios, names, cells),
            _sensors(scenarios, names, cells),
            pd.DataFrame(timing, index=index, columns=columns, dtype=np.float64),
        )

    def __repr__(self) -> str:
        sizes = [(self.table.sizes[axis], axis) for axis in ("scenario", "estimator")]
        said = (f"{count} {axis}{'' if count == 1 else 's'}" for count, axis in sizes)
        return f"Comparison({' × '.join(said)})"

    @property
    def ranking(self) -> pd.DataFrame:
        """Estimators, best first, by the geometric mean of their ratio to the oracle.

        Columns: ratio (over the scenarios where the estimator runs), worst, within (share of all scenarios
        with a ratio up to 1.5), false_alarm_rate (mean over scenarios), detection_rate, microseconds
        (median), scenarios (how many it ran). An estimator that runs in fewer scenarios is not comparable
        with one that runs in all, and stands below it.

        Scenarios without a ratio (NaN) are left out of an estimator's mean and maximum; a single one in which
        it diverges (inf) makes both infinite.
        """
        import pandas as pd

        ratio = self.table["ratio"].to_pandas()
        frame = pd.DataFrame(
            {
                "ratio": np.exp(np.log(ratio).mean()),
                "worst": ratio.max(),
                "within": (ratio <= 1.5).mean(),
                "false_alarm_rate": self.table["false_alarm_rate"].to_pandas().mean(),
                "detection_rate": self.table["detection_rate"].to_pandas().mean(),
                "microseconds": self.timing.median(),
                "scenarios": ratio.notna().sum(),
            }
        )
        return frame.sort_values(["scenarios", "ratio"], ascending=[False, True], kind="stable")

    def to_pandas(self) -> pd.DataFrame:
        """One row per scenario and estimator, with plant, attack and all figures."""
        scalars = [name for name, variable in self.table.data_vars.items() if "time" not in variable.dims]
        frame: pd.DataFrame = self.table[scalars].to_dataframe().reset_index()
        first = ["scenario", "plant", "attack", "estimator"]
        return frame[[*first, *(c for c in frame.columns if c not in first)]]

    def save(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Write table.nc, table.csv, sensors.csv and timing.csv, each whole or not at all; return the paths.

        The first three hold the same bytes for the same comparison, whoever computed it.
        """
        target = Path(folder)
        target.mkdir(parents=True, exist_ok=True)
        paths = [target / name for name in ("table.nc", "table.csv", "sensors.csv", "timing.csv")]
        with whole_file(paths[0]) as part:
            self.table.to_netcdf(part, engine="h5netcdf")
        for path, frame in zip(
            paths[1:], (self.to_pandas(), self.sensors, self.timing.reset_index()), strict=True
        ):
            with whole_file(path) as part:
                frame.to_csv(part, index=False, lineterminator="\n")
        return paths

    def plot(self) -> Any:
        """The ratio to the oracle of every estimator in every scenario, as a plotly figure."""
        from securestate.simulation._figures import heat_map

        return heat_map(self)

    def plot_errors(self, scenario: str) -> Any:
        """The mean squared error over time in one scenario, as a plotly figure."""
        from securestate.simulation._figures import errors

        return errors(self, scenario)


def _table(
    scenarios: Sequence[Scenario], names: Sequence[str], cells: Mapping[tuple[str, str], Cell]
) -> xr.Dataset:
    import xarray as xr

    steps = max(scenario.steps for scenario in scenarios)
    figures = {name: np.full((len(scenarios), len(names)), np.nan) for name in MEANING}
    curves = np.full((2, len(scenarios), len(names), steps), np.nan)
    for i, scenario in enumerate(scenarios):
        oracle = cells[scenario.name, names[0]].scores
        for j, name in enumerate(names):
            scores = cells[scenario.name, name].scores
            if scores is None:
                continue
            for figure, value in summarise_scores(scores, oracle).items():
                figures[figure][i, j] = value
            curves[:, i, j, : scenario.steps] = error_over_time(scores)
    axes = ("scenario", "estimator")
    data: dict[str, Any] = {name: (axes, figures[name], {"long_name": MEANING[name]}) for name in MEANING}
    data["refusal"] = (
        axes,
        np.array([[cells[s.name, n].refusal for n in names] for s in scenarios], dtype=object),
    )
    data["squared_error"] = ((*axes, "time"), curves[0])
    data["squared_error_half"] = ((*axes, "time"), curves[1])
    coords: dict[str, Any] = {
        "scenario": [scenario.name for scenario in scenarios],
        "estimator": list(names),
        "time": np.arange(steps),
        "plant": ("scenario", [scenario.plant_name for scenario in scenarios]),
        "attack": ("scenario", [scenario.attack_name for scenario in scenarios]),
        "attacked": ("scenario", [scenario.attack is not None for scenario in scenarios]),
        "attack_from": ("scenario", [min((p.start for p in s.parts), default=-1) for s in scenarios]),
        "steps": ("scenario", [scenario.steps for scenario in scenarios]),
        "score_from": ("scenario", [scenario.score_from for scenario in scenarios]),
        "seed": ("scenario", [scenario.seed for scenario in scenarios]),
    }
    return xr.Dataset(data, coords)


def _sensors(
    scenarios: Sequence[Scenario], names: Sequence[str], cells: Mapping[tuple[str, str], Cell]
) -> pd.DataFrame:
    import pandas as pd

    parts = []
    for scenario in scenarios:
        sensors, _ = scenario.sizes
        for name in names:
            scores = cells[scenario.name, name].scores
            if scores is not None:
                counts = dict(zip(PER_SENSOR, scores.per_sensor.astype(np.int64), strict=True))
                head = {"scenario": scenario.name, "estimator": name, "sensor": list(sensors)}
                parts.append(pd.DataFrame(head | counts))
    nobody = pd.DataFrame(columns=["scenario", "estimator", "sensor", *PER_SENSOR])
    frame = pd.concat(parts, ignore_index=True) if parts else nobody
    frame["false_alarm_rate"] = frame["false_alarms"] / frame["honest"].where(frame["honest"] > 0)
    frame["detection_rate"] = frame["detections"] / frame["lies"].where(frame["lies"] > 0)
    return frame

"""The reproduction of zhu2022 in its quick form: expected.json holds, and nothing half-done is written."""

import pytest
from rich.console import Console

from papers import _report as report
from papers.zhu2022 import __main__ as program
from papers.zhu2022.setting import FOLDER, Setting
from tests.papers.reproduction import Quick, Reproduction, judged


@pytest.fixture(scope="module")
def quick() -> Quick:
    return program.compute(Setting("quick"), Console(quiet=True))


@pytest.fixture(scope="module")
def rows(quick: Quick) -> dict[str, report.Row]:
    return judged(FOLDER, quick[0])


def test_every_number_is_that_of_an_independent_program(rows: dict[str, report.Row]) -> None:
    assert sum(row.value.error > 0 for row in rows.values()) > 150
    assert [key for key, row in rows.items() if not row.holds] == []


def test_the_package_has_the_beliefs_of_the_plain_lines(rows: dict[str, report.Row]) -> None:
    for init in ("split", "median", "mean"):
        assert rows[f"evidence.same.{init}"].value.number < 1e-9


def test_every_ordering_of_the_paper_holds_but_not_with_the_equation_as_printed(
    rows: dict[str, report.Row],
) -> None:
    stated = {key for key, row in rows.items() if row.reproduces is not None}
    assert len(stated) == 8
    assert {key for key in stated if not rows[key].reproduces} == {"literal.25.worse"}


def test_the_printed_equation_loses_most_runs_to_no_compensator(rows: dict[str, report.Row]) -> None:
    for attack in ("25", "26", "26c", "none"):
        assert rows[f"literal.{attack}.median"].value.number > 2
        assert rows[f"literal.{attack}.worse"].value.number > 0.9
    assert -32 < rows["evidence.swapped"].value.number < -25


def test_the_printed_mean_lowers_the_likelihood_and_the_weighted_one_does_not(
    rows: dict[str, report.Row],
) -> None:
    for attacked in (0, 1, 2, 4, 6):
        assert rows[f"evidence.falls.{attacked}"].value.number > 0.25
        assert rows[f"evidence.falls_precise.{attacked}"].value.number < 0.002


@pytest.mark.parametrize(("attack", "most"), [("none", 1.08), ("25", 1.5), ("26", 2.2), ("26c", 2.2)])
def test_innovation_mixture_stays_near_the_oracle(
    rows: dict[str, report.Row], attack: str, most: float
) -> None:
    for name in ("innovation", "innovation belief"):
        ratio = rows[f"claim.{attack}.{name} over oracle"].value
        assert ratio.number - 2 * ratio.error < most


@pytest.mark.parametrize("attack", ["25", "26c", "none"])
def test_innovation_mixture_needs_no_sensor_that_sees_everything(
    rows: dict[str, report.Row], attack: str
) -> None:
    ratio = rows[f"partial.{attack}.innovation"].value
    assert ratio.number - 2 * ratio.error < 1.5
    assert rows[f"partial.{attack}.mixture none"].value.number > 20


def test_hundreds_of_states_are_estimated_nearly_as_by_the_oracle(rows: dict[str, report.Row]) -> None:
    for size in (100, 200):
        ratio = rows[f"large.{size}.innovation"].value
        assert ratio.number - 2 * ratio.error < 1.12


class TestProgram(Reproduction):
    program = program
    folder = FOLDER
    figures = tuple(f"fig{number}.svg" for number in range(2, 9))
    off = ("evidence.same.split", 1.0)
    scale = "12 plants with one run of 100 attacked samples"

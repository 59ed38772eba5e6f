"""The reproduction of chen2022 in its quick form: expected.json holds, and nothing half-done is written."""

import pytest
from rich.console import Console

from papers import _report as report
from papers.chen2022 import __main__ as program
from papers.chen2022.setting import FOLDER, Setting
from tests.papers.reproduction import Quick, Reproduction, judged


@pytest.fixture(scope="module")
def quick() -> Quick:
    return program.compute(Setting("quick"), Console(quiet=True))


@pytest.fixture(scope="module")
def rows(quick: Quick) -> dict[str, report.Row]:
    return judged(FOLDER, quick[0])


def test_every_number_is_that_of_an_independent_program(rows: dict[str, report.Row]) -> None:
    assert sum(row.value.error == 0 for row in rows.values()) > 60
    assert sum(row.value.error > 0 for row in rows.values()) > 60
    assert [key for key, row in rows.items() if not row.holds] == []


def test_all_claims_hold_but_for_a_rival_set_too_low_and_the_controller(rows: dict[str, report.Row]) -> None:
    differs = {key for key, row in rows.items() if row.reproduces is False}
    assert differs == {"claim.local 1 over augmented 10", "controller.growth", "controller.radius"}


def test_the_fusion_does_not_beat_the_kalman_filter_of_the_protected_sensors(
    rows: dict[str, report.Row],
) -> None:
    for form, expected in (("printed", 1.02), ("exact", 1.0)):
        ratio = rows[f"claim.{form}.fusion over protected only"].value
        assert abs(ratio.number - expected) < 4 * ratio.error
    for better in ("exact.adaptive", "adaptive joint"):
        assert rows[f"claim.{better} over protected only"].value.number < 0.92


def test_only_the_exact_equations_claim_the_moments_that_runs_have(rows: dict[str, report.Row]) -> None:
    def distance(form: str, moment: str) -> float:
        claimed, found = (rows[f"moments.{form}.{key}"].value for key in (f"{moment} claimed", moment))
        return abs(claimed.number - found.number) / found.error

    assert all(distance("exact", moment) < 4 for moment in ("P1", "P12", "V", "P0"))
    assert all(distance("printed", moment) > 4 for moment in ("P12", "P0"))


class TestProgram(Reproduction):
    program = program
    folder = FOLDER
    figures = ("fig2.svg", "fig3.svg", "fig4.svg", "fig5.svg")
    off = ("gains.settled", 14.0)
    scale = "40 runs of 100 samples"

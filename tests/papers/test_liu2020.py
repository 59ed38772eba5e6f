"""The reproduction of liu2020 in its quick form: expected.json holds, and nothing half-done is written."""

from pathlib import Path

import pytest
from rich.console import Console

from papers import _report as report
from papers._report import Value
from papers.liu2020 import __main__ as program
from papers.liu2020.setting import FOLDER, Setting
from tests.papers.reproduction import Quick, Reproduction, judged


@pytest.fixture(scope="module")
def quick() -> Quick:
    return program.compute(Setting("quick"), Console(quiet=True))


@pytest.fixture(scope="module")
def rows(quick: Quick) -> dict[str, report.Row]:
    return judged(FOLDER, quick[0])


def test_every_number_without_chance_is_the_expected_one_at_full_tolerance(
    rows: dict[str, report.Row],
) -> None:
    certain = {key: row for key, row in rows.items() if row.value.error == 0}
    assert len(certain) > 25
    assert [key for key, row in certain.items() if not row.holds] == []


def test_every_simulated_number_is_the_expected_one_within_four_standard_errors(
    rows: dict[str, report.Row],
) -> None:
    simulated = {key: row for key, row in rows.items() if row.value.error > 0}
    assert len(simulated) > 60
    assert report.expected(FOLDER)["sigma"]["quick"] == 4
    assert [key for key, row in simulated.items() if not row.holds] == []


def test_only_the_minimum_under_attack_differs_from_what_the_paper_states(
    rows: dict[str, report.Row],
) -> None:
    differs = {key for key, row in rows.items() if row.reproduces is False}
    assert differs == {"fig2.best gamma", "fig2.excess at 0.75"}


def test_robust_fusion_is_within_five_percent_of_the_oracle_for_every_liar(
    rows: dict[str, report.Row],
) -> None:
    for sensor in range(1, 6):
        oracle = rows[f"attack.oracle run.{sensor}"].value.number
        for form in ("refit", "default"):
            assert rows[f"attack.{form}.{sensor}"].value.number < 1.05 * oracle


def test_paper_form_loses_by_the_square_of_a_lie_where_its_ratio_exceeds_one(
    rows: dict[str, report.Row],
) -> None:
    for sensor in (2, 3):
        assert rows[f"rho.paper.{sensor}"].value.number > 1
        small, large = (rows[f"growth.paper.{sensor}.{size}"].value.number for size in (100, 1000))
        assert 95 < large / small < 110


def test_files_are_written_all_or_none(tmp_path: Path) -> None:
    (tmp_path / "b").mkdir()
    with pytest.raises(IsADirectoryError):
        report.write_whole(tmp_path, {"a": "text", "b": "text"})
    assert [path.name for path in tmp_path.iterdir()] == ["b"]


def test_a_number_that_nothing_expects_is_refused(quick: Quick) -> None:
    with pytest.raises(KeyError, match="surprise"):
        report.judge(FOLDER, quick[0] | {"surprise": Value(1.0)}, "quick")


class TestProgram(Reproduction):
    program = program
    folder = FOLDER
    figures = ("fig2.svg",)
    off = ("trace", 0.84)
    scale = "20 runs of 150 samples"

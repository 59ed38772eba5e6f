"""The reproduction of chen2022 in its quick form: expected.json holds, and nothing half-done is written."""

from pathlib import Path

import pytest
from rich.console import Console

from papers import _report as report
from papers._report import Value
from papers.chen2022 import __main__ as program
from papers.chen2022 import figure
from papers.chen2022.monte_carlo import Curves
from papers.chen2022.setting import FOLDER, Setting

FIGURES = ["fig2.svg", "fig3.svg", "fig4.svg", "fig5.svg"]
Quick = tuple[dict[str, Value], Curves]


@pytest.fixture(scope="module")
def quick() -> Quick:
    return program.compute(Setting("quick"), Console(quiet=True))


@pytest.fixture(scope="module")
def rows(quick: Quick) -> dict[str, report.Row]:
    judged = report.judge(FOLDER, quick[0], "quick")
    keys = [row["key"] for section in report.expected(FOLDER)["sections"] for row in section["rows"]]
    return dict(zip(keys, judged, strict=True))


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


def test_readme_holds_a_table_line_for_every_quantity(rows: dict[str, report.Row]) -> None:
    text = (FOLDER / "README.md").read_text(encoding="utf-8")
    assert [row.quantity for row in rows.values() if f"| {row.quantity} |" not in text] == []
    assert "VIOLATED" not in text


def test_figures_are_the_same_text_for_the_same_numbers(quick: Quick) -> None:
    first, second = (figure.draw(quick[1]) for _ in range(2))
    assert first == second
    assert sorted(first) == FIGURES
    assert all(text.startswith("<?xml") for text in first.values())


def test_a_number_that_is_off_gives_exit_code_1_and_writes_nothing(
    quick: Quick, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found, curves = quick
    monkeypatch.setattr(program, "compute", lambda *_: (found | {"gains.settled": Value(14.0)}, curves))
    assert program.main(["--quick", "--out", str(tmp_path)]) == 1
    assert list(tmp_path.iterdir()) == []


def test_numbers_that_hold_give_exit_code_0_and_all_files(
    quick: Quick, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(program, "compute", lambda *_: quick)
    assert program.main(["--quick", "--out", str(tmp_path)]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["README.md", *FIGURES]
    written = (tmp_path / "README.md").read_text(encoding="utf-8")
    assert "40 runs of 100 samples" in written
    assert written.startswith((FOLDER / "README.md").read_text(encoding="utf-8").split(report.BEGIN)[0])

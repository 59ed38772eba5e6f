"""What holds for every paper's program; its numbers are the fixtures `quick` and `rows` of a module."""

from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from rich.console import Console

from papers import _report as report
from papers._report import Value

Quick = tuple[dict[str, Value], Any]


def judged(folder: Path, found: dict[str, Value]) -> dict[str, report.Row]:
    """Return the rows of the report by the keys of expected.json."""
    keys = [row["key"] for section in report.expected(folder)["sections"] for row in section["rows"]]
    return dict(zip(keys, report.judge(folder, found, "quick"), strict=True))


class Reproduction:
    """Subclass it as Test... and say of which paper."""

    program: ModuleType
    folder: Path
    figures: tuple[str, ...]
    off: tuple[str, float]  # a number that expected.json does not allow
    scale: str  # what the README written from the quick form says of it

    def test_readme_holds_a_table_line_for_every_quantity(self, rows: dict[str, report.Row]) -> None:
        text = (self.folder / "README.md").read_text(encoding="utf-8")
        assert [row.quantity for row in rows.values() if f"| {row.quantity} |" not in text] == []
        assert "VIOLATED" not in text

    def test_figures_are_the_same_text_for_the_same_numbers(
        self, quick: Quick, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(self.program, "compute", lambda *_: quick)
        draw = self.program.reproduce("quick", Console(quiet=True)).draw
        first, second = draw(), draw()
        assert first == second
        assert sorted(first) == list(self.figures)
        assert all(text.startswith("<?xml") for text in first.values())

    def test_a_number_that_is_off_gives_exit_code_1_and_writes_nothing(
        self, quick: Quick, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        (found, curves), (key, number) = quick, self.off
        monkeypatch.setattr(self.program, "compute", lambda *_: (found | {key: Value(number)}, curves))
        assert self.program.main(["--quick", "--out", str(tmp_path)]) == 1
        assert list(tmp_path.iterdir()) == []

    def test_numbers_that_hold_give_exit_code_0_and_all_files(
        self, quick: Quick, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(self.program, "compute", lambda *_: quick)
        assert self.program.main(["--quick", "--out", str(tmp_path)]) == 0
        assert sorted(path.name for path in tmp_path.iterdir()) == ["README.md", *self.figures]
        written = (tmp_path / "README.md").read_text(encoding="utf-8")
        assert self.scale in written
        published = (self.folder / "README.md").read_text(encoding="utf-8")
        assert written.startswith(published.split(report.BEGIN)[0])

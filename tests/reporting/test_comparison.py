import math
import re
from pathlib import Path

import numpy as np
import pytest

from securestate.reporting import write_comparison
from securestate.reporting.comparison import render
from securestate.reporting.curves import chart
from securestate.reporting.standing import Standing
from securestate.simulation import Comparison
from tests.reporting.made_comparisons import made_comparison
from tests.reporting.test_html import NASTY, Reader

FOUR = {"plants": ("tank", "grid")}


def headline(comparison: Comparison) -> str:
    return Standing.of(comparison).headline


def rows_of(html: str, heading: str) -> list[list[str]]:
    """The rows of the first table below a heading, as text."""
    table = html.split(f"{heading}</h", 1)[1].split("<tbody>", 1)[1].split("</tbody>", 1)[0]
    rows = re.findall("<tr.*?</tr>", table, re.DOTALL)
    return [[re.sub("<[^>]*>", "", cell) for cell in re.findall("<t[dh].*?</t[dh]>", row)] for row in rows]


def test_the_headline_names_the_best_its_mean_and_that_all_is_fine() -> None:
    comparison = made_comparison({"a": [1.0, 1.44], "b": [1.0, 400.0]})
    assert headline(comparison) == (
        "a comes closest to the oracle: 1.20 times its squared error in the geometric mean over 2 scenarios."
        " In every scenario some estimator comes within 1.5 times."
    )


@pytest.mark.parametrize(
    ("a", "said"),
    [
        ([1, 1, 1, 2], "In 1 no estimator comes within 1.5 times, but in all some comes within 3."),
        ([1, 1, 2, 9], "In 2 no estimator comes within 1.5 times, in 1 of these none within 3."),
        ([1, 1, 1, 1e50], "In 1 no estimator comes within 3 times."),
    ],
)
def test_the_headline_counts_the_scenarios_in_which_nobody_is_near(a: list[float], said: str) -> None:
    assert headline(made_comparison({"a": a, "b": [9e50] * 4}, **FOUR)).endswith(said)


def test_estimators_with_the_same_printed_mean_are_named_together() -> None:
    comparison = made_comparison({"a": [1.0, 1.2100], "b": [1.0, 1.2101], "c": [1.0, 2.0]}, spread=0.0)
    assert headline(comparison).startswith("a and b come closest to the oracle: 1.10 times its squared error")


def test_it_is_said_whom_the_runs_do_not_tell_from_the_best() -> None:
    ratios = {"a": [1.0, 1.2], "b": [1.0, 1.3], "c": [1.0, 9.0]}
    assert "The runs do not tell a from b: 95 % intervals overlap." in render(
        made_comparison(ratios, spread=0.1)
    )
    assert "The runs do not tell" not in render(made_comparison(ratios))


def test_an_estimator_that_cannot_run_everywhere_is_not_above_one_that_does() -> None:
    comparison = made_comparison({"picky": [1.0, "no <wide> view & more"], "steady": [2.0, 2.5]})
    html = render(comparison)
    assert headline(comparison).startswith(
        "steady, the only estimator that runs in all 2 scenarios, has 2.24"
    )
    assert [row[:2] for row in rows_of(html, "Ranking")] == [
        ["1", "steady"],
        ["–", "picky"],
        ["", "oracle yardstick"],
    ]
    text = "".join(Reader(html).text)
    assert (
        "picky runs in 1 of them. There it has 1.00 times the oracle’s squared error, steady 2.00 times."
        in text
    )
    assert "no <wide> view & more" in "".join(Reader(html).text)
    assert "picky cannot run in tank: bias:" in "".join(Reader(html).text)


def test_the_headline_says_among_whom_the_best_was_looked_for() -> None:
    ratios = {"picky": [1.0, "no"], "steady": [2.0, 2.0], "slow": [3.0, 3.0]}
    assert headline(made_comparison(ratios)).startswith(
        "Of those that run in all 2 scenarios, steady comes closest to the oracle:"
        " 2.00 times its squared error in the geometric mean."
    )


@pytest.mark.parametrize(
    ("ratios", "said"),
    [
        (
            {"a": [1.0, "no"], "b": ["no", 1.0]},
            "No estimator runs in all of 2 scenarios; at best one runs in 1.",
        ),
        ({"a": ["no", "no"]}, "No estimator can run in any of 2 scenarios."),
        ({"a": [1.0, math.inf]}, "Every estimator that runs in all of 2 scenarios diverges in at least one."),
        (
            {"a": [1.0, 4.0]},
            "a has 2.00 times the oracle’s squared error in the geometric mean over 2 scenarios.",
        ),
        ({}, "Only the oracle was run: there is nothing to compare."),
    ],
)
def test_the_headline_does_not_overclaim(ratios: dict[str, list[float | str]], said: str) -> None:
    comparison = made_comparison(ratios)
    assert headline(comparison).startswith(said)
    assert "</html>" in render(comparison)


@pytest.mark.parametrize(
    ("ratio", "said"),
    [
        (1.2, "a has 1.20 times the oracle’s squared error."),
        (2.0, "a has 2.00 times the oracle’s squared error. No estimator comes within 1.5 times."),
        (9.0, "a has 9.00 times the oracle’s squared error. No estimator comes within 3 times."),
    ],
)
def test_one_scenario_has_no_mean(ratio: float, said: str) -> None:
    assert headline(made_comparison({"a": [ratio]}, attacks=("bias",))) == said


def test_where_the_oracle_cannot_run_nothing_is_measured() -> None:
    comparison = made_comparison({"a": [1.2, 9.0]}, oracle=[1.0, "not detectable"])
    assert headline(comparison) == "a has 1.20 times the oracle’s squared error."
    assert "In 1 scenario the oracle cannot run" in render(comparison)
    nothing = made_comparison({"a": ["no", "no"]}, oracle=["not detectable", "not detectable"])
    assert headline(nothing).startswith("The oracle runs in no scenario")
    assert "</html>" in render(nothing)


def test_the_ranking_shows_the_numbers_of_the_comparison() -> None:
    comparison = made_comparison({"a": [1.0, 4.0], "b": [9.0, 9.0]})
    assert rows_of(render(comparison), "Ranking")[0] == [
        "1", "a", "2.00", "4.00", "tank: bias", "1 of 2", "2.5 %", "5.0 %", "25.0 %", "2.50", "2 of 2",
    ]  # fmt: skip


def test_the_matrix_shows_every_ratio_with_its_interval_and_marks_the_best() -> None:
    comparison = made_comparison({"a": [1.0, 123.4], "b": [1.4, 1e50]})
    html = render(comparison)
    assert rows_of(html, "Every scenario") == [
        ["tank"],
        ["none", "1.00 ★", "1.40", "2.00"],
        ["bias ✕ nothing works", "123 ★", "1e50", "2.00"],
    ]
    low, high = (float(comparison.table[f"ratio_{end}"].sel(estimator="b")[0]) for end in ("low", "high"))
    assert f'class="shade1" title="b: 1.40 ({low:.2f} to {high:.2f}) times the oracle’s' in html


def test_where_nothing_works_is_said_as_plainly_as_the_rest() -> None:
    html = render(made_comparison({"a": [1.0, 9.0, "no", 2.0], "b": [1.0, 40.0, "no", 2.0]}, **FOUR))
    said = re.findall("<li>(.*?)</li>", html.split("Where nothing works</h2>")[1].split("</section>")[0])
    assert [re.sub("<[^>]*>", "", one) for one in said] == [
        "tank: bias: the closest is a with 9.00 (8.88 to 9.12) times the oracle’s squared error.",
        "grid: none: no estimator can run.",
    ]
    assert "Nowhere: in every scenario" in render(made_comparison({"a": [1.0, 1.0]}))


def test_errors_detection_and_sensors_stand_plant_by_plant() -> None:
    html = render(made_comparison({"a": [1.0, 2.0]}, spread=0.0))
    assert rows_of(html, "Errors, with 95 % intervals")[3] == [
        "a", "4.00 (4.00 to 4.00)", "2.00 (2.00 to 2.00)", "1.25", "0.750", "0 %",
    ]  # fmt: skip
    assert rows_of(html, "Detection")[2][1:] == ["oracle", "5.0 %", "25.0 %", "3", "100 %", "62.5 %", "–"]
    sensors = html.split("By sensor")[1]
    assert re.findall(r'<th scope="row">(\w+)</th><td>(.*?)</td><td>(.*?)</td>', sensors)[:2] == [
        ("level", "25.0 %", "3.3 %"),
        ("flow", "25.0 %", "3.3 %"),
    ]


def test_sensors_that_only_have_numbers_get_no_table() -> None:
    assert "By sensor" not in render(made_comparison({"a": [1.0, 2.0]}, sensors=("s1", "s2")))


def test_names_are_text_never_markup() -> None:
    names = NASTY[:4]
    html = render(
        made_comparison(
            {names[0]: [1.0, 9.0], names[1]: [1.0, names[2]]},
            plants=(names[3],), attacks=("none", names[2]), sensors=(names[0], names[1]),
        ),
        title="<i>t</i>", source="<u>s</u>", notes=["<s>n</s>"],
    )  # fmt: skip
    reader = Reader(html)
    assert {tag for tag, _ in reader.elements}.isdisjoint({"script", "img", "i", "u", "s"})
    assert all(not key.startswith("on") for _, attributes in reader.elements for key in attributes)
    assert all(name in "".join(reader.text) for name in [*names, "<i>t</i>", "<u>s</u>", "<s>n</s>"])


def test_nothing_is_loaded_from_anywhere_and_nothing_runs() -> None:
    html = render(made_comparison({"a": [1.0, 9.0]}))
    reader = Reader(html)
    loading = {"src", "href", "srcset", "data", "action", "poster", "background", "xlink:href", "style"}
    assert [(t, a) for t, a in reader.elements if loading & a.keys()] == []
    assert re.search(r"https?://|@import|url\(|<script", html) is None
    assert "default-src 'none'; style-src 'unsafe-inline'\"" in html


def test_what_was_run_is_said() -> None:
    comparison = made_comparison({"a": [1.0, 2.0]}, runs=1)
    facts = re.findall("<dt>(.*?)</dt><dd>(.*?)</dd>", render(comparison, source="suite.toml"))
    assert dict(facts) == {
        "Scenarios": "2", "Plants": "1", "Estimators": "1 and the oracle", "Runs per scenario": "1",
        "Samples per run": "50", "Scored from sample": "10", "Seed": "7", "Source": "suite.toml",
    }  # fmt: skip
    assert "A scenario with one run has no interval" in render(comparison)


@pytest.mark.parametrize("steps", [50, 120, 130, 200, 1007])
def test_a_step_in_a_curve_is_drawn_at_its_sample(steps: int) -> None:
    at = steps * 2 // 3
    svg = chart({"oracle": np.where(np.arange(steps) < at, 1.0, 1000.0)}, 0, "title")
    (points,) = re.findall('points="(.*?)"', svg)
    x, y = np.array([[float(v) for v in point.split(",")] for point in points.split()]).T
    width = 396 - 44
    drawn = (x[y < y.max()][0] - 44) / width * (steps - 1)
    assert abs(drawn - at) <= max(1.0, steps / 120) + steps / width


def test_a_chart_labels_every_line_once_without_overlap_and_stays_inside() -> None:
    curves = {name: np.full(300, 1.0) for name in ("oracle", "a", "b")} | {"far": np.geomspace(1, 1e200, 300)}
    svg = chart(curves, 60, "title")
    labels = re.findall(r'<text x="418" y="([\d.]+)">(\w+)</text>', svg)
    heights = sorted(float(y) for y, _ in labels)
    assert sorted(name for _, name in labels) == sorted(curves)
    assert min(np.diff(heights)) >= 14.0 - 0.1
    numbers = [float(v) for points in re.findall('points="(.*?)"', svg) for v in re.split("[ ,]", points)]
    assert min(numbers) >= 0
    assert max(numbers) <= 520
    assert "scored from 60" in svg


@pytest.mark.parametrize(
    ("scored_from", "attack_from", "said"),
    [
        (0, None, []),
        (0, 0, []),
        (60, None, ["scored from 60"]),
        (60, 60, ["attack and scores from 60"]),
        (60, 90, ["scored from 60", "attack from 90"]),
        (0, 90, ["attack from 90"]),
        (60, 0, ["scored from 60"]),
    ],
)
def test_a_chart_marks_where_scores_and_attack_start(
    scored_from: int, attack_from: int | None, said: list[str]
) -> None:
    svg = chart({"oracle": np.ones(200)}, scored_from, "title", attack_from)
    assert re.findall(r'<text class="mark"[^>]*>([^<]*)</text>', svg) == said


def test_an_estimator_keeps_its_colour_where_another_one_cannot_run() -> None:
    curves = {name: np.ones(9) for name in ("oracle", "a", "b")}
    colour = '<polyline class="line c2"'
    assert chart(curves, 0, "title").count(colour) == 1
    without = chart(curves | {"a": np.ones(0)}, 0, "title")
    assert without.count(colour) == 1
    assert without.count("<polyline") == 2


@pytest.mark.parametrize("value", [0.0, math.inf, 1.0])
def test_odd_numbers_do_not_stop_a_chart(value: float) -> None:
    assert "nan" not in chart({"oracle": np.full(1, value)}, 0, "title")


def test_the_file_is_the_report_and_replaces_an_older_one(tmp_path: Path) -> None:
    target, comparison = tmp_path / "report.html", made_comparison({"a": [1.0, 2.0]})
    target.write_text("old")
    assert write_comparison(comparison, target) == target
    assert target.read_text(encoding="utf-8") == render(comparison)
    assert list(tmp_path.iterdir()) == [target]


def test_a_failing_write_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "report.html"
    target.write_text("old")

    def fail(source: object, destination: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr("os.replace", fail)
    with pytest.raises(OSError, match="disk full"):
        write_comparison(made_comparison({"a": [1.0, 2.0]}), target)
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]

"""The report of an identification: it begins with the verdict, and every number is that of the object."""

import re
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from securestate.identification import Grade, Identified, Problem, identify
from securestate.identification.verdict import criteria
from securestate.reporting import identification_facts as facts
from securestate.reporting import identification_figures as figures
from securestate.reporting import write_identification
from securestate.reporting.identification import render
from securestate.reporting.identification_criteria import why
from tests.reporting.test_html import NASTY, Reader
from tests.reporting.test_resilience import Balance, cells, section, tables, text

DT = 30.0


def readings(samples: int, seed: int = 1) -> NDArray[np.float64]:
    """Two slow states; sensors a, b, c see the first, d the second, e only noise."""
    rng = np.random.default_rng(seed)
    x = np.zeros((samples, 2))
    for k in range(1, samples):
        x[k] = x[k - 1] * [0.95, 0.7] + rng.normal(size=2)
    y = x @ np.array([[1.0, 1, 1, 0, 0], [0, 0, 0.5, 1, 0]]) + rng.normal(scale=0.5, size=(samples, 5))
    return np.asarray(200 + 10 * y)


NAMES, UNITS = ["a", "b", "c", "d", "e"], ["°C", "°C", "K", "bar", "m³/h"]


def learned(**settings: object) -> Identified:
    usual = {"order": 2, "dt": DT, "channel_names": NAMES, "units": UNITS, "name": "Kessel"}
    return identify(readings(1000), **{**usual, **settings})  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def found() -> Identified:
    return learned(order="auto")


@pytest.fixture(scope="module")
def bad() -> Identified:
    """Judged by a record of a plant that is slower and louder."""
    other = np.cumsum(readings(600, 5) - 200, axis=0) + 200
    return learned(held_out=other)


@pytest.fixture(scope="module")
def doubled() -> Identified:
    """A duplicate, a dead channel, and two segments with gaps that judge."""
    y = readings(1000)
    y = np.column_stack([y, y[:, 0], np.full(len(y), 7.0)])
    y[800:805, 2], y[900] = np.nan, np.nan
    judges = [y[750:860], y[860:]]
    names = [*NAMES, "a again", "dead"]
    with pytest.warns(match="never changes|repeat each other"):
        return identify(y[:750], order=2, channel_names=names, held_out=judges)


@pytest.fixture(scope="module", params=["found", "bad", "doubled"])
def one(request: pytest.FixtureRequest) -> Identified:
    chosen = request.getfixturevalue(request.param)
    assert isinstance(chosen, Identified)
    return chosen


def large(found: Identified, m: int) -> Identified:
    """The same evidence for more sensors."""
    plant, verdict = found.plant, found.verdict
    several = plant.with_sensors(
        plant.sensors[i % 5].replaced(name=f"TI {i}", channels=[f"TI {i}"]) for i in range(m - 5)
    )
    evidence = [replace(verdict.sensors[i % 5], name=several.sensor_names[i]) for i in range(m)]
    of, at = verdict.residuals, np.arange(m) % 5
    wide = {
        name: getattr(of, name)[..., at]
        for name in ("variance", "repeat", "ljung_box", "shift", "change", "level", "level_error", "counted")
    }
    return replace(
        found,
        plant=several,
        verdict=replace(
            verdict, sensors=tuple(evidence), residuals=replace(of, names=several.channel_names, **wide)
        ),
    )


def graded(found: Identified, grade: Grade, *problems: Problem) -> Identified:
    return replace(found, verdict=replace(found.verdict, grade=grade, problems=problems))


def rows(html: str, heading: str, which: int = 0) -> list[list[str]]:
    return [cells(row) for row in tables(section(html, heading))[which][1:]]


def test_every_page_is_well_formed_loads_nothing_and_runs_nothing(one: Identified) -> None:
    html = render(one)
    Balance(re.sub(r"<(rect|line|circle)([^>]*)/>", r"<\1\2></\1>", html))
    reader = Reader(html)
    loading = {"src", "href", "srcset", "data", "action", "poster", "background", "xlink:href", "style"}
    assert [(t, a) for t, a in reader.elements if loading & a.keys()] == []
    assert re.search(r"https?://|@import|url\(|<script", html) is None
    assert "default-src 'none'; style-src 'unsafe-inline'\"" in html
    assert re.search(r"\bnan\b|\binf\b", text(html)) is None


def test_the_page_begins_with_the_verdict(one: Identified) -> None:
    html = render(one)
    head = html.split("</header>")[0]
    first, *others = one.verdict.sentences()
    assert f"<h1>{first}</h1>" in unescape(head)
    assert f'<header class="{one.verdict.grade}">' in head
    assert all(f">{said}</li>" in unescape(head) for said in (*others, *one.remarks))
    assert one.headline in unescape(head)


def test_an_inadequate_verdict_looks_alarming(found: Identified, bad: Identified) -> None:
    assert bad.verdict.grade == Grade.INADEQUATE
    html = render(bad)
    assert '<body class="alarm">' in html
    assert '<p class="stamp"><span aria-hidden="true">✕</span> Inadequate</p>' in html
    assert "do not rely on it" in section(html, "Who can be checked")
    calm = render(found)
    assert '<body class="calm">' in calm
    assert "do not rely on it" not in calm


def test_problems_are_marked_by_how_bad_they_are(found: Identified) -> None:
    worse, bad = Problem(Grade.USABLE, "Somewhat off."), Problem(Grade.INADEQUATE, "Far < off.")
    html = render(graded(found, Grade.INADEQUATE, bad, worse))
    assert '<li class="inadequate">Far &lt; off.</li><li class="usable">Somewhat off.</li>' in html


def test_raised_noise_is_said(found: Identified) -> None:
    assert "raised by 12 %" in render(replace(found, noise_factor=1.12))
    assert "raised 3.5 times" in render(replace(found, noise_factor=3.5))
    assert "raised by" not in render(replace(found, noise_factor=1.0)).split("<main>")[0]


def test_every_sensor_has_a_bar_and_those_without_a_check_are_grey(one: Identified) -> None:
    _, *bars = tables(section(render(one), "Who can be checked"))[0]
    able = set(one.verdict.verifiable)
    assert len(bars) == one.plant.n_sensors
    for row, number in zip(bars, range(len(bars)), strict=True):
        name = re.sub(r" \d channels$", "", cells(row)[0])
        assert f'<tr class="{"checked" if name in able else "unchecked"}">' in row
        assert cells(row)[-1] == ("can be checked" if name in able else "cannot be checked")
        assert (number < len(able)) == (name in able)


def test_bars_are_as_long_as_what_is_explained(found: Identified) -> None:
    evidence = {sensor.name: sensor for sensor in found.verdict.sensors}
    _, *bars = tables(section(render(found), "Who can be checked"))[0]
    for row in bars:
        of = evidence[cells(row)[0]]
        drawn = dict(re.findall(r'<rect class="(\w+)" width="([\d.]+)%"', row))
        assert float(drawn["maybe"]) == pytest.approx(100 * max(of.explained, 0), abs=0.01)
        assert float(drawn["sure"]) == pytest.approx(100 * max(of.explained_least, 0), abs=0.01)
    assert evidence["a"].verifiable
    assert not evidence["e"].verifiable


def test_a_sensor_that_was_hardly_read_has_no_number(found: Identified) -> None:
    nothing = [replace(one, explained=np.nan, explained_least=np.nan) for one in found.verdict.sensors]
    html = render(replace(found, verdict=replace(found.verdict, sensors=tuple(nothing))))
    assert all(row[2:4] == ["–", "–"] for row in rows(html, "Who can be checked"))


def test_every_channel_is_in_the_table_with_its_numbers(one: Identified) -> None:
    html, plant, judged = render(one), one.plant, one.verdict.residuals
    listed = rows(html, "Every sensor")
    assert len(listed) == plant.m
    for row, channel in zip(listed, plant.channel_names, strict=True):
        if channel not in judged.names:  # it repeats the one above
            assert row[-4:] == ["as above", "", "", ""]
            continue
        k = judged.names.index(channel)
        assert f"{judged.repeat[0, k]:.2f}".replace("-", "−").replace("−0.00", "0.00") == row[-3]
        assert f"{judged.shift[k]:.2f}".replace("-", "−").replace("−0.00", "0.00") == row[-1]
    assert set(plant.sensor_names) <= {re.sub(r" \d channels$", "", row[0]) for row in listed}


def test_noise_is_shown_in_engineering_units(found: Identified) -> None:
    plant = found.plant
    for row, k in zip(rows(render(found), "Every sensor"), range(plant.m), strict=True):
        name, unit, point, variation, noise = row[:5]
        assert (name, unit) == (plant.channel_names[k], plant.units[k])
        assert float(point) == pytest.approx(plant.offset[k], rel=5e-3)
        assert float(variation) == pytest.approx(plant.scale[k], rel=5e-3)
        assert float(noise) == pytest.approx(plant.scale[k] * plant.R[k, k] ** 0.5, rel=5e-3)


def test_channels_that_are_one_sensor_stand_together(doubled: Identified) -> None:
    html = render(doubled)
    assert '<th scope="rowgroup" rowspan="2">a + a again <span class="tag">2 channels</span></th>' in html
    assert "dead never changes in the history and is left out." in html


def test_a_suspect_is_marked(found: Identified) -> None:
    blamed = replace(found, verdict=replace(found.verdict, blamed=("c",)))
    assert 'c <span class="tag far">suspect</span>' in section(render(blamed), "Who can be checked")
    assert '<span class="tag far">suspect' not in render(found)


def test_every_criterion_has_its_gauge_and_the_worst_is_the_grade(one: Identified) -> None:
    found = one.verdict.criteria
    worst = max((of.grade for of in found), key=list(Grade).index)
    assert worst == one.verdict.grade
    assert len(rows(render(one), "Why this grade")) == len(found)


def test_what_may_be_chance_is_no_reason(found: Identified) -> None:
    quiet = replace(found.verdict.residuals, counted=np.full(5, 30), shift=np.full(5, 0.6))
    loud = replace(quiet, counted=np.full(5, 300))
    for judged, said in ((quiet, "none beyond chance"), (loud, "0.60 sd, a")):
        told = why(list(criteria(judged, NAMES, None)))
        row = next(row for row in told.split("<tr>") if "Predictions off on average" in row)
        assert said in row


def test_every_dot_is_a_mean_of_normalised_errors(found: Identified) -> None:
    judged = found.verdict.residuals
    dots = figures.dots(judged)
    assert np.array_equal(dots.value, judged.nis / judged.channels)
    low, high = dots.band
    assert low == pytest.approx(stats.chi2.ppf(0.025, judged.channels) / judged.channels)
    assert high == pytest.approx(stats.chi2.ppf(0.975, judged.channels) / judged.channels)
    drawn = section(render(found), "How well it predicts")
    assert drawn.count('class="dot') == judged.samples
    assert drawn.count('class="dot out"') == np.sum(dots.value > high)


def test_a_long_record_is_drawn_with_few_dots_and_nothing_is_left_out(found: Identified) -> None:
    rng = np.random.default_rng(0)
    channels = rng.integers(1, 6, size=50_000)
    parts = tuple(np.ones((n, 5)) for n in (20_000, 29_990, 10))
    long = replace(found.verdict.residuals, nis=rng.chisquare(channels), channels=channels, segments=parts)
    dots = figures.dots(long)
    assert len(dots.value) <= 1000
    assert np.array_equal(dots.last[:-1], dots.first[1:])
    assert (dots.first[0], dots.last[-1]) == (0, 50_000)
    assert {20_000, 49_990} <= set(dots.first.tolist())
    assert np.sum(dots.value * dots.readings) == pytest.approx(long.nis.sum())
    low, high = dots.band
    assert np.mean((dots.value > low) & (dots.value < high)) == pytest.approx(0.95, abs=0.02)


def test_segments_are_drawn_apart(doubled: Identified, found: Identified) -> None:
    assert len(figures.lengths(doubled.verdict.residuals)) == 2
    assert figures.over_time(doubled.verdict.residuals).count('class="cut"') == 1
    assert figures.over_time(found.verdict.residuals).count('class="cut"') == 0


def test_what_lies_above_the_drawing_is_counted(found: Identified) -> None:
    judged = found.verdict.residuals
    nis = judged.nis.copy()
    nis[10] = 1e6
    assert "1 dot above the drawing." in render(
        replace(found, verdict=replace(found.verdict, residuals=replace(judged, nis=nis)))
    )


def test_the_histogram_counts_every_sample_and_expects_as_many(one: Identified) -> None:
    drawn = figures.spread(one.verdict.residuals)
    counted = re.findall(r": ([\d,]+) samples, expected (-?[\d.]+)", drawn)
    assert sum(int(n.replace(",", "")) for n, _ in counted) == one.verdict.residuals.samples
    assert sum(float(e) for _, e in counted) == pytest.approx(one.verdict.residuals.samples, abs=1.4)
    assert all(float(e) >= 0 for _, e in counted)


def test_every_autocorrelation_is_shown_and_what_is_certain_is_framed(one: Identified) -> None:
    judged = one.verdict.residuals
    _, *heat = tables(section(render(one), "Are errors white"))[0]
    for row, (k, name) in zip(heat, enumerate(judged.names), strict=True):
        assert cells(row)[0] == name
        shown = [float(cell.replace("−", "-")) for cell in cells(row)[1:11]]
        assert shown == pytest.approx(judged.repeat[:, k], abs=0.0051)
        certain = np.abs(judged.repeat[:, k]) > 4 / np.sqrt(judged.counted[k])
        assert row.count(" certain") == certain.sum()


def test_every_order_is_shown_and_the_chosen_one_marked(found: Identified) -> None:
    search, drawn = found.search, section(render(found), "How many states")
    listed = rows(render(found), "How many states")
    assert [int(row[0]) for row in listed] == sorted({*search.innovations, *search.independent})
    for n, free, own in listed:
        assert free == (f"{search.innovations[int(n)]:.3f}".replace("-", "−") if free else "")
        assert own == (f"{search.independent[int(n)]:.3f}".replace("-", "−") if own else "")
    assert f"chosen: {search.order}</text>" in drawn
    assert drawn.count(" picked") == 1
    assert "nats per sample" in text(drawn)


def test_an_order_that_was_given_is_said_without_a_drawing(bad: Identified) -> None:
    drawn = section(render(bad), "How many states")
    assert "The number of states was given: 2." in drawn
    assert "<svg" not in drawn


def test_what_independent_noises_lose_is_said(found: Identified) -> None:
    for cost, said in ((0.25, "lose 0.25 nats"), (-0.5, "by 0.5 nats per sample better")):
        assert said in render(replace(found, search=replace(found.search, cost=cost)))


def test_the_slowest_mode_is_a_time(found: Identified) -> None:
    size = float(np.max(np.abs(np.linalg.eigvals(found.plant.A))))
    html = section(render(found), "How it was made")
    assert f"<dd>{size:.4f}</dd>" in html
    assert f"<dd>{facts.duration(-DT / np.log(size), DT)}</dd>" in html
    assert facts.constant(1.0, DT) == "never fades"
    assert facts.duration(600.0, DT) == "10.0 min"


def test_drawings_say_in_words_what_they_show(found: Identified) -> None:
    reader = Reader(render(found))
    drawings = [a for tag, a in reader.elements if tag == "svg" and "aria-hidden" not in a]
    assert len(drawings) == 3
    assert all(a["role"] == "img" and a["aria-label"] for a in drawings)


def test_a_hundred_sensors_are_folded_and_the_page_stays_small(found: Identified) -> None:
    html = render(large(found, 100))
    assert len(html) < 500_000
    unable = 20 * (5 - len(found.verdict.verifiable))
    assert f"<summary>60 more sensors, {min(60, unable)} of which cannot be checked</summary>" in html
    assert "<summary>60 more channels</summary>" in html
    assert len(rows(html, "Every sensor")) == 100
    named = {row[0] for which in (0, 1) for row in rows(html, "Who can be checked", which)}
    assert len(named) == 100


def test_a_record_without_a_sample_is_reported_too(found: Identified) -> None:
    none = {"nis": np.zeros(0), "channels": np.zeros(0, np.int64), "segments": (np.zeros((0, 5)),)}
    empty = replace(
        found.verdict.residuals, counted=np.zeros(5, np.int64), repeat=np.full((10, 5), np.nan), **none
    )
    html = render(replace(found, verdict=replace(found.verdict, residuals=empty)))
    assert "There is no sample to judge the model by." in html


def test_names_are_text_never_markup() -> None:
    named = learned(channel_names=NASTY, units=["<i>K</i>"] * 5, name="<u>Süd & Co</u>")
    html = render(named, title="<s>t</s>", source="<em>s</em>")
    Balance(re.sub(r"<(rect|line|circle)([^>]*)/>", r"<\1\2></\1>", html))
    reader = Reader(html)
    assert {tag for tag, _ in reader.elements}.isdisjoint({"script", "img", "i", "u", "s", "em"})
    assert all(not key.startswith("on") for _, attributes in reader.elements for key in attributes)
    told = "".join(reader.text)
    assert all(name in told for name in [*NASTY, "<u>Süd & Co</u>", "<i>K</i>", "<s>t</s>", "<em>s</em>"])


def test_the_file_is_the_report_and_replaces_an_older_one(found: Identified, tmp_path: Path) -> None:
    target = tmp_path / "report.html"
    target.write_text("old")
    assert write_identification(found, target) == target
    assert target.read_text(encoding="utf-8") == render(found)
    assert list(tmp_path.iterdir()) == [target]


def test_what_cannot_be_written_leaves_nothing_behind(found: Identified, tmp_path: Path) -> None:
    (tmp_path / "report.html").mkdir()
    with pytest.raises(OSError, match=r"report\.html"):
        write_identification(found, tmp_path / "report.html")
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]

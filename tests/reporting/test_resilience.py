"""The report of an analysis: what it says is what was found, and nothing else gets in."""

import re
from html import unescape
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from securestate import Plant, Resilience, Sensor, analyse
from securestate._analysis_text import headline
from securestate.reporting import resilience_figures, write_resilience
from securestate.reporting.page import percent
from securestate.reporting.resilience import render
from securestate.reporting.resilience_figures import COLUMNS, ROWS, chosen, partners
from securestate.resilience import Visibility, limit, visibility
from tests.reporting.test_html import NASTY, Reader

VOID = {"meta", "br"}


def plant(rows: dict[str, list[float]], A: object = None, **settings: object) -> Plant:
    """A plant with one sensor per row of C; names that end in ! are protected."""
    sensors = [
        Sensor(name.rstrip("!"), C=row, R=1, protected=name.endswith("!")) for name, row in rows.items()
    ]
    n = len(next(iter(rows.values())))
    return Plant(np.eye(n) if A is None else A, np.eye(n), sensors, **settings)  # type: ignore[arg-type]


ZERO = plant({"a": [1, 0], "b": [1, 0], "c": [1, 0], "d": [1, 1]})
ONE = plant({"a": [1, 0], "b": [1, 0], "c": [1, 0.5], "d": [1, 1], "e": [0, 1]}, np.diag([1.0, 1.1]))
BLIND = plant({"a": [0, 1], "b": [0, 1], "c": [0, 1]}, np.diag([1.1, 1.0]), name="Kessel")
GUARDED = plant({"a": [1, 0], "b!": [1, 1], "c": [0, 1]}, np.diag([1.0, 1.1]))
NEAR = plant({name: [1, k] for k, name in enumerate("abcde", 1)}, np.diag([1.0, 1.0 + 1e-5]))
TURN = plant({"a": [1, 0], "b": [1, 0], "c": [0, 1]}, [[0.6, 0.8], [-0.8, 0.6]])
LARGE = plant(
    {f"{kind}{i}": list(np.eye(30)[i]) for i in range(30) for kind in "pqr"} | {"all": [1.0] * 30},
    0.9 * np.eye(30),
)
PLANTS = {"zero": ZERO, "one": ONE, "blind": BLIND, "guarded": GUARDED, "turn": TURN, "large": LARGE}


FOUND: dict[tuple[int, int | None], Resilience] = {}


def resilience(of: Plant, attacked: int | None = None) -> Resilience:
    """What is found about one of the plants above, computed once."""
    key = (id(of), attacked)
    if key not in FOUND:
        FOUND[key] = analyse(of, attacked)
    return FOUND[key]


def page(of: Plant) -> str:
    return render(resilience(of))


def text(html: str) -> str:
    return " ".join("".join(Reader(html).text).split())


def section(html: str, heading: str) -> str:
    return html.split(f"<h2>{heading}</h2>")[1].split("</section>")[0]


def cells(row: str) -> list[str]:
    return [unescape(re.sub("<[^>]*>", "", one)) for one in re.findall(r"<t[dh].*?</t[dh]>", row)]


def tables(html: str) -> list[list[str]]:
    """Every table as its rows, in HTML; the first is the heads."""
    return [re.findall("<tr.*?</tr>", one) for one in re.findall("<table.*?</table>", html, re.DOTALL)]


def numbers(view: Visibility, row: int) -> tuple[str, str]:
    """How many see a mode and how many liars it survives, as the page should say it."""
    guards = int((view.sees[row] & view.protected).sum())
    seen = f"{view.count[row]} + {guards} protected" if guards else str(view.count[row])
    return seen, "any" if guards else str(view.survives[row]) if view.sees[row].any() else "not seen"


class Balance(HTMLParser):
    """Fails where an element is not closed, or closed in another one."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.feed(html)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: object) -> None:
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.mark.parametrize("name", PLANTS)
def test_every_page_is_well_formed_loads_nothing_and_runs_nothing(name: str) -> None:
    html = page(PLANTS[name])
    Balance(html)
    reader = Reader(html)
    loading = {"src", "href", "srcset", "data", "action", "poster", "background", "xlink:href", "style"}
    assert [(t, a) for t, a in reader.elements if loading & a.keys()] == []
    assert re.search(r"https?://|@import|url\(|<script", html) is None
    assert "default-src 'none'; style-src 'unsafe-inline'\"" in html


@pytest.mark.parametrize("name", PLANTS)
def test_the_page_begins_with_what_is_survived(name: str) -> None:
    found = resilience(PLANTS[name])
    html = render(found)
    assert f"<h1>{headline(found)}</h1>" in html
    alarming = name in ("zero", "blind")
    assert f'<body class="{"alarm" if alarming else "calm"}">' in html


@pytest.mark.parametrize("name", PLANTS)
def test_every_cell_of_the_picture_is_that_of_the_view(name: str) -> None:
    found = resilience(PLANTS[name])
    view, part = found.view, chosen(found.view)
    head, *rows = tables(section(render(found), "Who sees what"))[0]
    names = [found.plant.sensor_names[i] for i in part.columns]
    assert [title.lstrip("◆ ") for title in cells(head)[3:]] == names
    assert len(rows) == len(part.rows)
    for row, k in zip(rows, part.rows, strict=True):
        assert tuple(cells(row)[1:3]) == numbers(view, int(k))
        shown = re.findall(r'<td class="(\w+)[^"]*" title="([^"]*): ([^"]*)"', row)
        assert [name for _, name, _ in shown] == names
        for (kind, _, told), i in zip(shown, part.columns, strict=True):
            assert (kind == "blind") != view.sees[k, i]
            assert told == (percent(view.share[k, i]) if view.sees[k, i] else "blind")


def test_the_weakest_mode_is_on_top_and_its_sensors_are_marked() -> None:
    head, first, second = tables(section(page(ZERO), "Who sees what"))[0]
    assert cells(first)[0] == "mode 1 (x2) weakest"
    assert re.findall(r'class="see\d hit" title="(\w+)', first) == ["d"]
    assert re.findall(r'class="sensor hit" title="(\w+)', head) == ["d"]
    assert "hit" not in second


def test_the_list_of_all_modes_names_their_sensors_the_best_first() -> None:
    listed = tables(section(page(LARGE), "Who sees what"))[1]
    view = resilience(LARGE).view
    assert len(listed) == 1 + len(view.modes) > ROWS
    for row, mode, share in zip(listed[1:], view.modes, view.share, strict=True):
        best = LARGE.sensor_names[int(np.argmax(share))]
        assert cells(row)[0] == str(mode)
        assert cells(row)[3].split(", ")[0] == best


def test_a_large_plant_is_cut_and_says_so() -> None:
    html, view = page(LARGE), resilience(LARGE).view
    part = chosen(view)
    assert len(part.rows) <= ROWS
    assert len(part.columns) <= COLUMNS < LARGE.n_sensors
    assert f"Shown: the {len(part.rows)} weakest of {len(view.modes)} modes" in html
    assert (
        f" and {len(part.columns)} of {LARGE.n_sensors} sensors; the others see none of these modes." in html
    )
    assert "Shown:" not in page(ONE)


def test_a_mode_that_more_sensors_see_than_can_be_shown_leaves_out_the_weakest_of_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(resilience_figures, "COLUMNS", 20)
    found = analyse(plant({f"s{i}": [1 + i] for i in range(30)}))
    assert chosen(found.view).columns.tolist() == list(range(10, 30))
    told = "Shown: every mode and 20 of 30 sensors; 10 more see one of these modes."
    assert told in render(found)


def test_before_and_after_show_the_numbers_of_both_plants() -> None:
    found = resilience(ONE)
    first = found.options[0]
    view = visibility(limit(first.plant, found.limit.cut))
    head, *rows = tables(section(render(found), "What would help"))[1]
    assert [title for title in cells(head) if title.startswith("+ ")]
    assert len(rows) == len(view.modes)
    for k, row in enumerate(rows):
        (old,) = [j for j, mode in enumerate(found.view.modes) if mode.eigenvalue == view.modes[k].eigenvalue]
        now, then = numbers(view, k), numbers(found.view, old)
        told = [a if a == b else f"{b} → {a}" for a, b in zip(now, then, strict=True)]
        assert cells(row)[1:3] == told


def test_a_direction_that_was_not_shown_before_says_so() -> None:
    found = resilience(ZERO)
    changed = visibility(limit(found.options[0].plant, found.limit.cut))
    assert None in partners(found.view, changed)
    assert "not shown above" in section(render(found), "What would help")
    assert partners(found.view, found.view) == list(range(len(found.view.modes)))


def test_every_option_stands_with_the_limit_after_it() -> None:
    found = resilience(ONE)
    _, *rows = tables(section(render(found), "What would help"))[0]
    assert len(rows) == len(found.options) >= 2
    for row, option in zip(rows, found.options, strict=True):
        after = limit(option.plant, found.limit.cut)
        said = "any number of liars" if after.unlimited else f"{after.max_attacked} liars"
        assert cells(row)[2:] == [str(option.total), "yes, proved" if option.fewest else "fewer may do", said]
        assert all(name in cells(row)[1] for name, _ in option.items)


def test_what_is_twice_needed_is_counted() -> None:
    assert "2 × d" in section(page(ZERO), "What would help")


def test_nothing_has_to_change_where_everything_is_survived() -> None:
    helped = section(page(GUARDED), "What would help")
    assert "Nothing has to change: it survives any number of liars." in helped
    assert "<table" not in helped
    assert "Nothing has to change to survive 1 liar." in render(resilience(ONE, 1))


def test_the_smallest_protected_set_is_named() -> None:
    found = resilience(ZERO)
    assert found.protection is not None
    assert "protect 2 sensors (no smaller set does): " + ", ".join(found.protection[0]) in page(ZERO)


def test_protected_sensors_are_marked_and_counted_apart() -> None:
    head, *rows = tables(section(page(GUARDED), "Who sees what"))[0]
    assert "◆ b" in cells(head)
    assert [cells(row)[1:3] for row in rows] == [["1 + 1 protected", "any"]] * 2


def test_a_mode_that_nobody_sees_is_not_hidden() -> None:
    html = page(BLIND)
    assert "Kessel cannot be secured: mode 1.1 (x1) is seen by no sensor." in text(html)
    assert cells(tables(html)[0][1])[:3] == ["mode 1.1 (x1) weakest", "0", "not seen"]
    assert "None: no estimator can follow a mode that no sensor sees." in text(html)


def test_the_estimators_have_their_margins_and_verdicts() -> None:
    found = resilience(ONE)
    html = section(render(found), "Which estimator")
    rows = [cells(row) for row in tables(html)[0][1:]]
    assert f"<b>{found.method}</b>" in html
    margins = [(form.form, margin) for form in found.forms for margin in form.margins]
    assert len(rows) == len(margins) + 1
    for row, (form, margin) in zip(rows, margins, strict=False):
        assert row[0] == f"Sparse fusion, {form} form"
        assert row[1] == str(margin.attacked)
        assert row[2].replace("∞", "inf") in str(margin)
        assert row[3] == margin.verdict
    assert rows[-1][3:] == ["cannot be used", "no sensor is protected"]


def test_a_limit_that_rests_on_digits_is_shown_by_tolerance() -> None:
    found = resilience(NEAR)
    rows = [cells(row) for row in tables(section(render(found), "How firm the limit is"))[0][1:]]
    assert rows == [[f"{tol:.0e}", str(low)] for tol, low, _ in found.profile]
    assert "How firm the limit is" not in page(ONE)


def test_names_are_text_never_markup() -> None:
    C = np.array([[1, 0], [1, 1], [1, 0], [1, 2], [0, 1]])
    sensors = [Sensor(name, C=row, R=1) for name, row in zip(NASTY, C, strict=True)]
    named = Plant(np.eye(2), np.eye(2), sensors, state_names=[NASTY[0], "Höhe <i>"], name="<u>Süd & Co</u>")
    html = render(analyse(named), title="<s>t</s>", source="<em>s</em>")
    Balance(html)
    reader = Reader(html)
    assert {tag for tag, _ in reader.elements}.isdisjoint({"script", "img", "i", "u", "s", "em"})
    assert all(not key.startswith("on") for _, attributes in reader.elements for key in attributes)
    attributes = [value for _, all_of in reader.elements for value in all_of.values()]
    told = "".join(reader.text)
    assert all(any(f"{name}:" in str(value) for value in attributes) for name in NASTY)
    assert all(name in told for name in ["<u>Süd & Co</u>", "Höhe <i>", "<s>t</s>", "<em>s</em>"])


def test_the_file_is_the_report_and_replaces_an_older_one(tmp_path: Path) -> None:
    target = tmp_path / "report.html"
    target.write_text("old")
    assert write_resilience(resilience(ZERO), target) == target
    assert target.read_text(encoding="utf-8") == page(ZERO)
    assert list(tmp_path.iterdir()) == [target]

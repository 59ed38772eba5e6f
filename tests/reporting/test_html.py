import base64
import gzip
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from securestate.errors import InputError
from securestate.estimators.run import Run
from securestate.plant import Plant, Sensor
from securestate.reporting import write_report
from securestate.reporting.blocks import channel_labels, normalised_innovation
from securestate.reporting.html import render
from securestate.reporting.payload import Block, unpack
from tests.reporting.made_runs import SHIFT, lie, made_lies, made_run, unchecked, with_silence

NASTY = [
    "</script><script>alert(1)</script>",
    "a \"quoted\" 'name'",
    "x<b>&amp;",
    "<img src=x onerror=alert(1)>",
    "ok",
]


class Reader(HTMLParser):
    """Collects elements with their attributes, and the text outside scripts and styles."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []
        self.scripts: list[tuple[dict[str, str | None], str]] = []
        self._inside = ""
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        self._inside = tag

    def handle_endtag(self, tag: str) -> None:
        self._inside = ""

    def handle_data(self, data: str) -> None:
        if self._inside == "script":
            self.scripts.append((self.elements[-1][1], data))
        elif self._inside != "style":
            self.text.append(data)


def manifest_of(html: str) -> dict[str, Any]:
    found = [text for attributes, text in Reader(html).scripts if attributes.get("id") == "manifest"]
    manifest: dict[str, Any] = json.loads(found[0])
    return manifest


def table_of(html: str, name: str) -> np.ndarray:
    """A table as the report holds it."""
    described = manifest_of(html)["blocks"][name]
    text = next(t for a, t in Reader(html).scripts if a.get("id") == f"data-{name}")
    return unpack(Block(text=text, **described))


def test_the_headline_is_the_verdict() -> None:
    html = render(made_run(liars=(1, 3)))
    assert headline_of(html).replace("\u00a0", " ") == "2 of 5 sensors lie: XMEAS 2 and XMEAS 4."
    assert "<h1>No sensor is suspected.</h1>" in render(made_run())


def test_the_head_tells_every_finding_with_a_link_to_its_moment() -> None:
    html = render(made_lies({1: lie(160, 400), 3: lie(50, 120)}, rate=1e-3))
    head = html.split("<h1>")[1].split("<dl>")[0]
    assert re.findall(r'<li><b>(.*?)</b> (\w+ \w+) <button class="go" data-sample="(\d+)">', head) == [
        ("XMEAS 4", "lied from", "50"),
        ("XMEAS 2", "lies since", "160"),
    ]
    assert "2.50 h</button> to 5.95 h (samples 50 to 119): about +12.0" in head
    assert "suspected in 240 of 240 samples, 0.24 by chance, mean trust 0.05.</li>" in head


def test_a_status_is_told_with_its_times_and_what_to_do() -> None:
    run = made_lies({})
    run.status[[50, 51, 200]] = 5
    html = render(run)
    assert "<p>AMBIGUOUS in 3 samples, 2 stretches, the longest from 2.50 h to 2.55 h" in html
    table = html.split("<h2>Status</h2>")[1].split("</table>")[0]
    assert re.findall('data-sample="([0-9]+)"', table) == ["50", "200"]
    assert "do not act on a name from this time" in table


def headline_of(html: str) -> str:
    heading = re.search("<h1>(.*?)</h1>", html)
    assert heading
    return re.sub("<[^>]*>", "", heading[1])


def test_the_headline_never_parts_a_number_from_its_word() -> None:
    html = render(made_run(2, 3, liars=(0,), names=["XMEAS 11 separator temperature", "ok", "fine"]))
    assert headline_of(html).endswith("XMEAS\u00a011 separator temperature.")


def test_liars_come_first_and_every_sensor_is_named_once_without_a_click() -> None:
    html = render(made_run(sensors=40, liars=(7, 30)))
    section = html[html.index("<h2>Sensors</h2>") : html.index("<h2>Trust</h2>")]
    assert re.findall(r'data-label="Sensor">(XMEAS \d+)', section) == ["XMEAS 8", "XMEAS 31"]
    assert "No alarm from 38 other sensors:" in section
    assert sorted(re.findall(r"XMEAS (\d+)", section), key=int) == [str(i + 1) for i in range(40)]
    assert "<details" not in section


def test_a_sensor_with_an_isolated_alarm_or_a_gap_is_named_with_it() -> None:
    run = with_silence(made_run(), 2, slice(5, 9))
    run.suspected[50, 0] = True
    text = " ".join(" ".join(Reader(render(run)).text).split())
    assert "Isolated alarms: XMEAS 1 1 sample ." in text
    assert "No alarm from 4 other sensors: XMEAS 2, XMEAS 3 1.3 % missing , XMEAS 4," in text


def test_sensors_that_cannot_be_checked_have_a_place_a_remark_and_a_legend_that_say_so() -> None:
    run = unchecked(made_run(liars=(1,)), (1, 2))
    html = render(run)
    rows = html.split("<tbody>")[1].split("</tbody>")[0]
    verdicts = re.findall(r'data-label="Sensor">(XMEAS \d+)(.*?)</td>.*?"verdict-.*?">(.*?)<', rows)
    assert verdicts == [("XMEAS 2", ' <span class="tag">cannot be checked</span>', "lies")]
    assert "<b>Cannot be checked:</b> <span>XMEAS 3.</span>" in html
    assert "<p>2 of 5 sensors cannot be checked: no other sensor vouches for them.</p>" in html
    assert "No alarm from 3 other sensors:" in html
    assert "</span>sent nothing, or cannot be checked</span>" in html
    assert [s["uncheckable"] for s in manifest_of(html)["sensors"]] == [False, True, True, False, False]
    assert np.isnan(table_of(html, "trust")[:, 2]).all()
    assert ">no</td>" in html.split("Verifiable</th>")[1]


def test_a_plant_whose_sensors_can_all_be_checked_is_not_said_to_be_otherwise() -> None:
    html = render(made_run(liars=(1,)))
    assert "</span>sent nothing</span>" in html
    page = "".join(Reader(html).text)
    assert "cannot be checked" not in page and "Verifiable" not in page


def test_charts_call_the_only_channel_of_a_sensor_by_the_name_of_the_sensor() -> None:
    plant = made_run().plant
    pair = Sensor("pair", np.ones((2, 3)), 1.0)
    single = Sensor("XMEAS 1 feed", np.ones((1, 3)), 1.0, channels=["XMEAS 1"])
    mixed = Plant(plant.A, plant.Q, [pair, single])
    assert channel_labels(mixed) == ["pair.1", "pair.2", "XMEAS 1 feed"]


def test_the_noise_that_charts_are_scaled_by_is_in_file_units() -> None:
    channels = manifest_of(render(made_run()))["channels"]
    assert [c["noise"] for c in channels] == pytest.approx([2 * 0.5**0.5] * 5)


def test_what_was_run_is_said() -> None:
    time = np.datetime64("2024-03-01", "ns") + np.arange(300) * np.timedelta64(180, "s")
    text = " ".join(
        Reader(render(made_run(time=time), title="Night shift", source="a/b.csv", notes=["One note."])).text
    )
    for said in (
        "Night shift",
        "a/b.csv",
        "One note.",
        "Made-up reactor",
        "SparseFusion",
        "300",
        "kalman probability",
    ):
        assert said in text
    assert "2024-03-01 00:00 to 2024-03-01 14:57" in text


def test_a_silent_sensor_is_reported_as_such_and_not_as_honest() -> None:
    text = " ".join(Reader(render(with_silence(made_run(), 2, slice(None)))).text)
    assert "Sent nothing during the whole run: XMEAS 3." in text
    assert "No data: XMEAS 3." in " ".join(text.split())


def test_names_from_files_are_text_never_markup() -> None:
    plain, nasty = (
        Reader(render(made_run(liars=(0,)))),
        Reader(
            render(
                made_run(liars=(0,), names=NASTY),
                title="<i>t</i>",
                source="<u>s</u>",
                notes=["<s>n</s>", "a & b"],
            )
        ),
    )
    extra = {"p": 2, "div": 1, "dt": 1, "dd": 1}  # two notes and the source
    for tag in {tag for tag, _ in nasty.elements} | {tag for tag, _ in plain.elements}:
        count = sum(t == tag for t, _ in nasty.elements) - sum(t == tag for t, _ in plain.elements)
        assert count == extra.get(tag, 0), tag
    assert all(not key.startswith("on") for _, attributes in nasty.elements for key in attributes)
    assert all(name in "".join(nasty.text) for name in NASTY)
    assert [s["name"] for s in manifest_of(render(made_run(names=NASTY)))["sensors"]] == NASTY


def test_the_names_of_sensors_that_are_not_blamed_are_not_red(tmp_path: Path) -> None:
    made = made_lies({1: lie(100, 160), 2: lie(50, 400)}, rate=1e-3)
    attack = np.where(made.suspected, [0, 1.5, SHIFT, 0, 0], 0.0)
    html = write_report(
        replace(made, attack=attack, estimator="SecureFilter"), tmp_path / "r.html"
    ).read_text()
    assert (
        "<li><b>XMEAS 3</b> lies" in html and '<li><b class="unblamed">XMEAS 2</b> raised 60 alarms' in html
    )
    assert "faint alarms" in html and ".findings b:not(.unblamed)" in html


def test_nothing_is_loaded_from_anywhere() -> None:
    html = render(made_run(liars=(1,)))
    reader = Reader(html)
    loading = {"src", "href", "srcset", "data", "action", "poster", "background", "xlink:href"}
    assert [(t, a) for t, a in reader.elements if loading & a.keys()] == []
    assert {t for t, _ in reader.elements}.isdisjoint({"link", "base", "iframe", "object", "embed", "img"})
    assert re.search(r"https?://|@import|url\(", html) is None


def test_the_policy_forbids_fetching_and_names_the_scripts_by_hash() -> None:
    reader = Reader(render(made_run()))
    policy = next(a["content"] for t, a in reader.elements if t == "meta" and "http-equiv" in a)
    assert policy is not None
    assert policy.startswith("default-src 'none';")
    assert policy.count("'sha256-") == 2
    assert "unsafe-inline" not in policy.split(";")[1]


def test_the_chart_library_is_inside() -> None:
    packed = next(text for a, text in Reader(render(made_run())).scripts if a.get("id") == "plotly")
    assert b"Plotly" in gzip.decompress(base64.b64decode(packed))


def test_the_report_holds_every_sample_of_the_run() -> None:
    run = with_silence(made_run(liars=(1,), samples=2000), 3, slice(50, 90))
    html = render(run)
    assert np.array_equal(table_of(html, "suspected"), run.suspected)
    assert np.array_equal(table_of(html, "status")[:, 0], run.status)
    assert_within(table_of(html, "trust"), run.trust, 0.002)
    assert_within(table_of(html, "ratio"), normalised_innovation(run), 0.01)
    assert_within(table_of(html, "x"), run.x, 0.3 / 200)
    assert_within(table_of(html, "attack"), run.attack, 2.0 / 200)


def assert_within(found: np.ndarray, expected: np.ndarray, tolerance: float) -> None:
    assert np.array_equal(np.isnan(found), np.isnan(expected))
    assert np.nanmax(np.abs(found - expected)) <= tolerance * (1 + 1e-6)


def test_irregular_times_are_kept_exactly() -> None:
    time = np.cumsum(np.random.default_rng(6).uniform(0.5, 1.5, 300))
    html = render(made_run(time=time))
    assert manifest_of(html)["time"]["regular"] is None
    packed = next(text for a, text in Reader(html).scripts if a.get("id") == "data-time")
    assert np.array_equal(np.frombuffer(gzip.decompress(base64.b64decode(packed)), "<f8"), time)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("all NaN", {"attack": np.nan, "innovation": np.nan, "trust": np.nan, "x": np.nan, "x_std": np.nan}),
        ("infinite", {"x_std": np.inf, "innovation": np.inf}),
        ("no noise", {"innovation_std": 0.0}),
    ],
)
def test_odd_numbers_do_not_stop_a_report(name: str, change: dict[str, float]) -> None:
    run = made_run()
    arrays = {key: np.full_like(getattr(run, key), value) for key, value in change.items()}
    assert "</html>" in render(replace(run, **arrays)), name


def test_one_sample_of_one_sensor_is_enough() -> None:
    html = render(made_run(1, 1, samples=1, liars=(0,), since=0))
    assert headline_of(html).replace("\u00a0", " ") == "1 of 1 sensors lies: XMEAS 1."
    assert "1 state, 1 sensor, 1 channel" in html


def test_the_file_is_the_report_and_replaces_an_older_one(tmp_path: Path) -> None:
    target = tmp_path / "report.html"
    target.write_text("old")
    assert write_report(made_run(), target) == target
    assert target.read_text(encoding="utf-8") == render(made_run())
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
        write_report(made_run(), target)
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_a_missing_folder_is_an_error_and_makes_nothing(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="nowhere"):
        write_report(made_run(), tmp_path / "nowhere" / "report.html")
    assert list(tmp_path.iterdir()) == []


def test_a_batch_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^run: "):
        write_report(replace(made_run(), x=np.zeros((2, 300, 3))), tmp_path / "report.html")
    assert list(tmp_path.iterdir()) == []


def test_sixty_channels_and_a_hundred_thousand_samples_fit_in_thirty_megabytes(tmp_path: Path) -> None:
    run: Run = made_run(30, 60, 100_000, liars=(3, 17, 44), since=70_000)
    size = write_report(run, tmp_path / "report.html").stat().st_size
    assert 2e6 < size < 30e6

"""The command that analyses a plant before any data."""

import re
from pathlib import Path

import numpy as np
import pytest

import securestate as ss
from securestate.estimators import METHODS
from tests.cli.helpers import Command

SEEN_ONCE = ss.Plant(
    np.eye(2),
    np.eye(2),
    [ss.Sensor(name, C=[1, 0], R=1) for name in "abc"] + [ss.Sensor("d", C=[1, 1], R=1)],
)
BLIND = ss.Plant(
    np.diag([1.1, 1.0]), np.eye(2), [ss.Sensor("gauge", C=[0, 1], R=1)], state_names=["mass", "heat"]
)


@pytest.fixture
def weak(folder: Path) -> Path:
    """The folder with a plant that survives no liar."""
    SEEN_ONCE.save(folder / "weak.toml")
    return folder


def table(out: str) -> list[list[str]]:
    lines = out.splitlines()
    rule = next(i for i, line in enumerate(lines) if line.startswith("──"))
    return [re.split(r"\s{2,}", line.strip()) for line in lines[rule + 1 :] if line.startswith("mode ")]


def test_it_prints_the_analysis_and_the_modes_weakest_first(weak: Path, command: Command) -> None:
    done = command("analyse", "weak.toml")
    assert (done.code, done.err) == (0, "")
    said = str(ss.analyse(SEEN_ONCE))
    assert done.out.startswith(f"weak.toml:\n{said}\n\nmode ")
    assert table(done.out) == [["mode 1 (x2)", "1", "0"], ["mode 1 (x1)", "4", "1"]]


def test_protected_sensors_are_counted_apart(folder: Path, command: Command) -> None:
    done = command("analyse", "plant.toml")
    assert done.code == 0
    assert "two tanks survives any number of lying sensors: the protected ones see every mode." in done.out
    assert [row[1:] for row in table(done.out)] == [["3 + 1 protected", "any"]] * 2


def test_of_many_modes_the_weakest_are_printed(folder: Path, command: Command) -> None:
    sensors = [ss.Sensor(f"s{i}", C=np.eye(15)[i % 15], R=1) for i in range(20)]
    ss.Plant(0.5 * np.eye(15), np.eye(15), sensors).save(folder / "wide.toml")
    done = command("analyse", "wide.toml")
    assert len(table(done.out)) == 12
    assert "\n3 more\n" in done.out


@pytest.mark.parametrize(("attacked", "code"), [(None, 0), (1, 4), (2, 4)])
def test_it_ends_with_4_if_fewer_are_survived_than_asked(
    weak: Path, command: Command, attacked: int | None, code: int
) -> None:
    asked = () if attacked is None else ("--attacked", str(attacked))
    assert command("analyse", "weak.toml", *asked).code == code


def test_what_is_survived_ends_with_0(folder: Path, command: Command) -> None:
    ss.Plant([[1]], [[1]], [ss.Sensor(n, C=[1], R=1) for n in "abc"]).save(folder / "three.toml")
    assert command("analyse", "three.toml", "--attacked", "1").code == 0
    assert command("analyse", "three.toml", "--attacked", "2").code == 4
    more = command("analyse", "plant.toml", "--attacked", "9")
    assert more.code == 2
    assert "at most the 3 sensors that are not protected, received 9" in more.err


def test_a_mode_that_nobody_sees_ends_with_4(folder: Path, command: Command) -> None:
    BLIND.save(folder / "blind.toml")
    done = command("analyse", "blind.toml", "--report", "r.html")
    assert done.code == 4
    assert "cannot be secured: mode 1.1 (mass) is seen by no sensor." in done.out
    assert ["mode 1.1 (mass)", "0", "not seen"] in table(done.out)
    assert (folder / "r.html").exists()


def test_the_report_is_one_file_and_says_so(weak: Path, command: Command) -> None:
    before = {path.name for path in weak.iterdir()}
    done = command("analyse", "weak.toml", "--report", "report.html")
    assert done.code == 0
    assert done.out.endswith("\nwrote report.html\n")
    assert {path.name for path in weak.iterdir()} - before == {"report.html"}
    html = (weak / "report.html").read_text(encoding="utf-8")
    assert "<dd>weak.toml</dd>" in html
    assert "</html>" in html


def test_a_report_that_fails_leaves_the_old_one(
    weak: Path, command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    (weak / "report.html").write_text("old")
    before = {path.name for path in weak.iterdir()}

    def fail(*_: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr("os.replace", fail)
    done = command("analyse", "weak.toml", "--report", "report.html", "--improved", "better.toml")
    assert (done.code, done.out) == (2, "")
    assert "disk full" in done.err
    assert (weak / "report.html").read_text() == "old"
    assert {path.name for path in weak.iterdir()} == before


def test_the_improved_plant_survives_what_was_asked(weak: Path, command: Command) -> None:
    done = command("analyse", "weak.toml", "--attacked", "2", "--improved", "better.toml")
    assert done.code == 4
    first = ss.analyse(SEEN_ONCE, 2).options[0]
    assert f"wrote better.toml ({first})" in done.out
    assert ss.Plant.load(weak / "better.toml") == first.plant
    assert command("analyse", "better.toml", "--attacked", "2").code == 0


def test_without_advice_no_plant_is_written(folder: Path, command: Command) -> None:
    done = command("analyse", "plant.toml", "--improved", "better.toml")
    assert done.code == 0
    assert done.err == "better.toml is not written: nothing has to change\n"
    assert not (folder / "better.toml").exists()


def test_the_tolerance_is_the_models_accuracy(folder: Path, command: Command) -> None:
    sensors = [ss.Sensor(f"s{k}", C=[1.0, k], R=1) for k in range(1, 6)]
    ss.Plant(np.diag([1.0, 1.0 + 1e-5]), np.eye(2), sensors).save(folder / "near.toml")
    assert command("analyse", "near.toml", "--attacked", "2").code == 0
    assert command("analyse", "near.toml", "--attacked", "2", "--tolerance", "1e-3").code == 4


def test_quiet_prints_nothing(weak: Path, command: Command) -> None:
    done = command("analyse", "weak.toml", "--quiet", "--report", "report.html")
    assert done == (0, "", "")
    assert (weak / "report.html").exists()


def test_a_plant_that_varies_in_time_ends_with_4_and_advice(folder: Path, command: Command) -> None:
    A = np.stack([np.eye(1), 0.5 * np.eye(1)])
    ss.Plant(A, [[1]], [ss.Sensor("a", C=[1], R=1)]).save(folder / "varying.toml")
    done = command("analyse", "varying.toml", "--report", "report.html")
    assert (done.code, done.out) == (4, "")
    assert "error: the limit needs a plant with constant A and C" in done.err
    assert "advice: " in done.err
    assert not (folder / "report.html").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "Missing argument"),
        (["nothing.toml"], "nothing.toml: "),
        (["honest.csv"], "honest.csv"),
        (["weak.toml", "--attacked", "0"], "attacked: expected a whole number >= 1"),
        (["weak.toml", "--attacked", "two"], "--attacked"),
        (["weak.toml", "--tolerance", "1"], "tol: expected a number in 0..0.1"),
        (["weak.toml", "--tolerance", "nan"], "tol: "),
        (["weak.toml", "--time-limit", "-1"], "time_limit: expected a number >= 0"),
        (["weak.toml", "--report", "r.pdf"], "--report: expected a file name ending in .html"),
        (["weak.toml", "--report", "no/r.html"], "--report: expected a file in a folder that exists"),
        (["weak.toml", "--improved", "r.json"], "--improved: expected a file name ending in .toml"),
        (["weak.toml", "--improved", "no/r.toml"], "--improved: expected a file in a folder that exists"),
        (["weak.toml", "--improved", "weak.toml"], "--improved: expected another file than the plant's"),
    ],
)
def test_a_mistake_ends_with_2_and_its_name(
    weak: Path, command: Command, arguments: list[str], message: str
) -> None:
    before = {path.name: path.read_bytes() for path in weak.iterdir()}
    done = command("analyse", *arguments)
    assert (done.code, done.out) == (2, "")
    assert done.err.startswith("error: ")
    assert message in done.err
    assert {path.name: path.read_bytes() for path in weak.iterdir()} == before


def test_help_tells_what_4_means_here(command: Command) -> None:
    out = " ".join(command("analyse", "--help").out.split())
    assert "4 the plant does not survive that" in out
    assert "securestate analyse plant.toml --attacked 2" in out


def test_the_method_that_is_named_can_be_designed_and_is_the_secure_filter_where_that_can() -> None:
    sensors = [ss.Sensor(name, C=[1.0], R=1.0) for name in "abcd"]
    guarded = [*sensors[:3], ss.Sensor("d", C=[1.0], R=1.0, protected=True)]
    shared = np.eye(4)
    shared[0, 1] = shared[1, 0] = 0.3
    common = ss.Plant([[1.0]], [[1.0]], [ss.Sensor(name, C=[1.0]) for name in "abcd"], R=shared)
    plants = [ss.Plant([[1.0]], [[1.0]], owned) for owned in (sensors, guarded)]
    for plant, method in zip([*plants, common], ["secure", "secure", "sparse"], strict=True):
        found = ss.analyse(plant)
        assert found.method == method
        METHODS[method].design(plant)
    assert "always believed" in ss.analyse(plants[1]).why
    assert "which secure does not allow" in ss.analyse(common).why

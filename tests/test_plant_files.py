"""Plant files: what is read, what is refused with which words, and that plants survive the round trip."""

import io
import pickle
import re
import textwrap
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import securestate.plant
from securestate import Plant, PlantError, SecurestateError, Sensor

SMALL = """
[plant]
A = [[1, 0.1], [0, 1]]
Q = [0, 1]
B = [[0], [1]]

[[input]]
name = "pump"

[[sensor]]
name = "gauge"
C = [1, 0]
R = 0.5
"""

shared_folder = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])


def written(folder: Path, text: str, name: str = "plant.toml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def refused(path: Path) -> str:
    with pytest.raises(PlantError) as caught:
        Plant.load(path)
    assert str(path) in caught.value.argument
    return str(caught.value).replace(f"{path}: ", "")


def documented() -> str:
    """Return the example that the documentation of the format shows."""
    _, example = (securestate.plant.__doc__ or "").split("name and C::\n")
    return textwrap.dedent(example)


def test_the_documented_example_is_the_plant_it_describes(tmp_path: Path) -> None:
    plant = Plant.load(written(tmp_path, documented()))
    expected = Plant(
        [[0.9, 0.0], [0.1, 0.9]],
        np.diag([1e-4, 1e-4]),
        [
            Sensor("gauge 1", C=[1.0, 0.0], R=0.01, D=[0.05], protected=True),
            Sensor(
                "probe",
                C=[[0.0, 1.0], [0.0, 2.0]],
                R=[0.02, 0.03],
                channels=["probe.low", "probe.high"],
                verifiable=False,
                unit="cm",
                offset=[40.0, 80.0],
                scale=2.5,
            ),
        ],
        B=[[0.2], [0.0]],
        dt=0.5,
        state_names=["level 1", "level 2"],
        input_names=["pump"],
        input_offset=3.0,
        input_scale=1.5,
        name="two tanks",
    )
    assert plant == expected


def test_a_small_file_needs_only_dynamics_noise_and_a_sensor(tmp_path: Path) -> None:
    plant = Plant.load(written(tmp_path, SMALL))
    assert (plant.dt, plant.name, plant.state_names, plant.units) == (1.0, "", ("x1", "x2"), ("",))


@pytest.mark.parametrize("Q", ["2", "[2, 2]", "[[2, 0], [0, 2]]"])
def test_process_noise_may_be_a_variance_a_diagonal_or_a_matrix(tmp_path: Path, Q: str) -> None:
    plant = Plant.load(written(tmp_path, SMALL.replace("Q = [0, 1]", f"Q = {Q}")))
    np.testing.assert_array_equal(plant.Q, 2 * np.eye(2))


def test_states_may_be_named_in_tables(tmp_path: Path) -> None:
    text = SMALL + '[[state]]\nname = "level"\n[[state]]\nname = "flow"\n'
    assert Plant.load(written(tmp_path, text)).state_names == ("level", "flow")


def test_a_byte_order_mark_is_no_obstacle(tmp_path: Path) -> None:
    path = tmp_path / "plant.toml"
    path.write_bytes(b"\xef\xbb\xbf" + SMALL.encode())
    assert Plant.load(path).n == 2


def test_correlated_noise_and_feedthrough_may_be_given_for_all_channels(tmp_path: Path) -> None:
    text = SMALL.replace("R = 0.5", "").replace("Q = ", "R = [[0.5]]\nD = [[3]]\nQ = ")
    plant = Plant.load(written(tmp_path, text))
    assert (plant.R, plant.D) == (0.5, 3)


MISTAKES = [
    ("", "", "[plant]: expected a table, received none"),
    ("[plant]", "[plan]", "plan: expected a key among plant, state, input, sensor, received unknown 'plan'"),
    ("[plant]", "[plan]", "(did you mean 'plant'?)"),
    ("A = ", "a = ", "[plant] a: expected a key among"),
    ("A = ", "a = ", "(did you mean 'A'?)"),
    ("Q = ", "R = ", "[plant] Q: expected a value, received none"),
    ("C = [1, 0]", "", "[[sensor]] number 1 C: expected a value, received none"),
    ("C = ", "prtected = true\nC = ", "[[sensor]] number 1 prtected: expected a key among"),
    ("C = ", "prtected = true\nC = ", "(did you mean 'protected'?)"),
    (
        "C = ",
        'protected = "yes"\nC = ',
        "sensor 'gauge': protected: expected True or False, received 'yes'",
    ),
    (
        "C = ",
        "verifiable = 0\nC = ",
        "sensor 'gauge': verifiable: expected True or False, received 0 (int)",
    ),
    ("C = [1, 0]", "C = [[1, 0], [1]]", "sensor 'gauge': C: expected an array of real numbers"),
    ("C = [1, 0]", "C = 1979-05-27", "sensor 'gauge': C: expected an array of real numbers"),
    ("C = [1, 0]", "C = [1, nan]", "sensor 'gauge': C: expected finite numbers, received nan at [1]"),
    ("C = [1, 0]", 'C = "seen"', "[[sensor]] number 1 C: expected numbers, or the name of an array"),
    ("R = 0.5", "R = -0.5", "sensor 'gauge': R: expected variances > 0"),
    ("R = 0.5", "R = 1e999", "sensor 'gauge': R: expected finite numbers"),
    ('name = "gauge"', "name = 3", "[[sensor]] number 1 name: expected text, received 3 (int)"),
    ("[[sensor]]", "[sensor]", "[[sensor]]: expected tables written as [[sensor]]"),
    ("[[input]]", "[input]", "[[input]]: expected tables written as [[input]]"),
    ('name = "pump"', "offset = 1", "[[input]] number 1 name: expected a value, received none"),
    (
        'name = "pump"',
        'name = "pump"\nscale = [1]',
        "[[input]] number 1 scale: expected shape (), one number",
    ),
    ('name = "pump"', 'name = "pump"\nunit = "V"', "[[input]] number 1 unit: expected a key among"),
    ('name = "pump"', 'name = "pump"\n[[input]]\nname = "b"', "input_names: expected 1 names, received 2"),
    ("B = [[0], [1]]", "", "input_names: expected no names, as there is neither B nor D"),
    ("B = ", 'state_names = ["a"]\nB = ', "state_names: expected 2 names, received 1"),
    ("B = ", "dt = 0\nB = ", "dt: expected one number > 0, received 0 (int)"),
    ("B = ", "dt = true\nB = ", "dt: expected an array of real numbers, received booleans"),
    ("B = ", "arrays = 3\nB = ", "[plant] arrays: expected the name of an .npz file beside it, received 3"),
    ("B = ", 'arrays = "../a.npz"\nB = ', "[plant] arrays: expected the name of an .npz file beside it"),
    ("B = ", 'arrays = "none.npz"\nB = ', "none.npz, received nothing there"),
    ("A = [[1", "A = [[1,,", "plant file: expected valid TOML"),
    ("A = [[1, 0.1]", "A = [" + "[" * 5000, "plant file: expected valid TOML"),
    ("A = [[1, 0.1]", "A = [[1" + "0" * 5000 + ", 0.1]", "plant file: expected valid TOML"),
    ("A = [[1, 0.1]", "A = [[1" + "0" * 400 + ", 0.1]", "A: expected an array of real numbers"),
]


@pytest.mark.parametrize(("old", "new", "message"), MISTAKES)
def test_a_wrong_file_is_refused_naming_file_and_key(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    text = SMALL.replace(old, new, 1) if old else new
    assert message in refused(written(tmp_path, text))


def test_states_named_twice_are_refused(tmp_path: Path) -> None:
    text = SMALL.replace("B = ", 'state_names = ["a", "b"]\nB = ') + '[[state]]\nname = "a"\n'
    assert "[plant] state_names: expected state_names or [[state]]" in refused(written(tmp_path, text))


def test_what_is_no_readable_file_is_refused(tmp_path: Path) -> None:
    assert "nothing there" in refused(tmp_path / "none.toml")
    (tmp_path / "folder.toml").mkdir()
    assert "not a file" in refused(tmp_path / "folder.toml")
    (tmp_path / "binary.toml").write_bytes(bytes(range(256)))
    assert "readable text in UTF-8" in refused(tmp_path / "binary.toml")


@pytest.mark.parametrize("path", [3, None, b"plant.toml", "plant.txt", "plant"])
def test_a_path_that_names_no_toml_file_is_refused(path: Any) -> None:
    with pytest.raises(PlantError, match="path: expected"):
        Plant.load(path)
    with pytest.raises(PlantError, match="path: expected"):
        big(2).save(path)


def with_arrays(folder: Path, content: bytes) -> Path:
    (folder / "plant.npz").write_bytes(content)
    return written(folder, SMALL.replace("A = [[1, 0.1], [0, 1]]", 'arrays = "plant.npz"\nA = "dynamics"'))


def npz(**arrays: Any) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def test_a_matrix_may_be_an_array_of_the_file_beside(tmp_path: Path) -> None:
    path = with_arrays(tmp_path, npz(dynamics=np.array([[1, 2], [3, 4]])))
    np.testing.assert_array_equal(Plant.load(path).A, [[1.0, 2.0], [3.0, 4.0]])


def test_an_array_that_is_not_there_is_refused_naming_the_nearest(tmp_path: Path) -> None:
    message = refused(with_arrays(tmp_path, npz(Dynamic=np.eye(2))))
    assert "[plant] A: expected numbers, or the name of an array" in message
    assert "unknown 'dynamics' (did you mean 'Dynamic'?)" in message


def test_a_damaged_or_dangerous_array_file_is_refused(tmp_path: Path) -> None:
    whole = npz(dynamics=np.eye(2))
    objects = npz(dynamics=np.array([{"a": 1}], dtype=object))
    single = io.BytesIO()
    np.save(single, np.eye(2))
    for content in (b"", b"garbage", whole[:-40], objects, pickle.dumps([1]), single.getvalue()):
        assert "[plant] arrays: expected an NPZ file of plain arrays" in refused(
            with_arrays(tmp_path, content)
        )


def test_arrays_of_text_or_complex_numbers_are_refused(tmp_path: Path) -> None:
    assert "A: expected an array of real numbers" in refused(with_arrays(tmp_path, npz(dynamics=["a"])))
    assert "received complex numbers" in refused(with_arrays(tmp_path, npz(dynamics=1j * np.eye(2))))


def big(n: int, seed: int = 0, **changes: Any) -> Plant:
    rng = np.random.default_rng(seed)
    G = rng.normal(size=(n, n))
    sensors = [
        Sensor("a", C=rng.normal(size=(3, n)), R=[1, 2, 3]),
        Sensor("b", C=rng.normal(size=n), R=1 / 3),
    ]
    return Plant(**{"A": rng.normal(size=(n, n)), "Q": G @ G.T, "sensors": sensors} | changes)


def test_small_matrices_are_written_in_the_file_itself(tmp_path: Path) -> None:
    big(20).save(tmp_path / "p.toml")
    assert [path.name for path in tmp_path.iterdir()] == ["p.toml"]
    assert Plant.load(tmp_path / "p.toml") == big(20)


def test_large_matrices_go_to_a_file_beside_it(tmp_path: Path) -> None:
    big(21).save(tmp_path / "p.toml")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["p.npz", "p.toml"]
    assert (tmp_path / "p.toml").stat().st_size < 2000
    with zipfile.ZipFile(tmp_path / "p.npz") as archive:
        assert archive.namelist() == ["A.npy", "Q.npy", "sensor1.C.npy", "sensor2.C.npy"]
    assert Plant.load(tmp_path / "p.toml") == big(21)


def test_time_varying_and_correlated_plants_survive_the_round_trip(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    sensors = [Sensor("a", C=rng.normal(size=(4, 2, 2))), Sensor("b", C=[1, 0])]
    G = rng.normal(size=(3, 5))
    plant = Plant(rng.normal(size=(4, 2, 2)), np.eye(2), sensors, R=G @ G.T, D=rng.normal(size=(3, 2)))
    plant.save(tmp_path / "p.toml")
    assert Plant.load(tmp_path / "p.toml") == plant


def test_only_a_sensor_that_is_not_verifiable_says_so_in_the_file(tmp_path: Path) -> None:
    plant = Plant([[1]], [[1]], [Sensor("a", C=[1], R=1), Sensor("b", C=[1], R=1, verifiable=False)])
    plant.save(tmp_path / "p.toml")
    before, after = (tmp_path / "p.toml").read_text().split('name = "b"')
    assert "verifiable" not in before
    assert "verifiable = false" in after


number = st.floats(-1e300, 1e300, allow_subnormal=True)
positive = st.floats(1e-300, 1e300)
printable = st.text(st.characters(categories=["L", "N", "P", "S"]), min_size=1, max_size=6)


@st.composite
def plants(draw: st.DrawFn) -> Plant:
    n, N, p = (draw(st.integers(low, 3)) for low in (1, 1, 0))
    names = draw(st.lists(printable, min_size=N, max_size=N, unique=True))
    numbers = lambda count: draw(st.lists(number, min_size=count, max_size=count))  # noqa: E731
    sensors = [
        Sensor(
            name,
            C=[draw(positive), *numbers(n - 1)],
            R=draw(positive),
            D=numbers(p) if p else None,
            protected=draw(st.booleans()),
            verifiable=draw(st.booleans()),
            channels=[f"{name}:{i}"],
            offset=draw(number),
            scale=draw(positive),
            unit=draw(printable | st.just("")),
        )
        for i, name in enumerate(names)
    ]
    return Plant(
        np.reshape(numbers(n * n), (n, n)),
        np.diag(draw(st.lists(positive, min_size=n, max_size=n))),
        sensors,
        B=np.reshape(numbers(n * p), (n, p)),
        dt=draw(positive),
        input_offset=numbers(p),
        input_scale=[draw(positive) for _ in range(p)],
        name=draw(printable | st.just("")),
    )


@shared_folder
@given(plants())
def test_the_round_trip_is_exact(tmp_path: Path, plant: Plant) -> None:
    plant.save(tmp_path / "p.toml")
    assert Plant.load(tmp_path / "p.toml") == plant


def test_saving_replaces_whole_files_and_leaves_nothing_else(tmp_path: Path) -> None:
    for n in (30, 25):
        big(n).save(tmp_path / "p.toml")
        assert Plant.load(tmp_path / "p.toml") == big(n)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["p.npz", "p.toml"]


def test_a_failed_save_leaves_the_old_files_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    big(30).save(tmp_path / "p.toml")

    def full_disk(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full_disk)
    with pytest.raises(PlantError, match="No space left on device"):
        big(25).save(tmp_path / "p.toml")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["p.npz", "p.toml"]
    assert Plant.load(tmp_path / "p.toml") == big(30)


def test_a_place_that_cannot_be_written_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(PlantError, match=re.escape(str(tmp_path / "none" / "p.toml"))):
        big(2).save(tmp_path / "none" / "p.toml")
    (tmp_path / "p.toml").mkdir()
    with pytest.raises(PlantError, match="expected the name of a file, received a folder"):
        big(30).save(tmp_path / "p.toml")
    assert [path.name for path in tmp_path.iterdir()] == ["p.toml"]


def mutated(data: st.DataObject, content: bytes) -> bytes:
    """Return the bytes with some cut out, replaced, doubled or put in."""
    for _ in range(data.draw(st.integers(1, 4))):
        start = data.draw(st.integers(0, len(content)))
        stop = min(len(content), start + data.draw(st.integers(0, 12)))
        pieces = st.binary(max_size=4) | st.sampled_from(
            [b"[", b"]", b'"', b"=", b"\n", b"-", b"9", b"nan", b"{}"]
        )
        content = content[:start] + data.draw(pieces | st.just(content[start:stop] * 2)) + content[stop:]
    return content


def loads_or_is_refused(path: Path) -> None:
    try:
        assert isinstance(Plant.load(path), Plant)
    except SecurestateError as error:
        assert str(path) in str(error)


@shared_folder
@given(st.data())
def test_a_mutated_plant_file_gives_a_plant_or_an_error(tmp_path: Path, data: st.DataObject) -> None:
    path = tmp_path / "plant.toml"
    path.write_bytes(mutated(data, documented().encode()))
    loads_or_is_refused(path)


@shared_folder
@given(st.data())
def test_a_mutated_array_file_gives_a_plant_or_an_error(tmp_path: Path, data: st.DataObject) -> None:
    loads_or_is_refused(with_arrays(tmp_path, mutated(data, npz(dynamics=np.eye(2)))))


@shared_folder
@given(st.data())
def test_a_file_with_swapped_values_gives_a_plant_or_an_error(tmp_path: Path, data: st.DataObject) -> None:
    lines = documented().splitlines()
    at = data.draw(
        st.sampled_from([i for i, line in enumerate(lines) if "=" in line and "#" not in line[:1]])
    )
    values = [
        "1",
        "-1",
        "0",
        "true",
        '"x"',
        '""',
        "[]",
        "[[]]",
        "[[1]]",
        "{}",
        "{a = 1}",
        "nan",
        "inf",
        "1e400",
    ]
    values += ["1979-05-27", "[1, 2, 3]", '["a", 1]', "[[1, 2], [3]]", "[{}]", "[true]", "9" * 30, "07:32:00"]
    lines[at] = f"{lines[at].split('=')[0]}= {data.draw(st.sampled_from(values))}"
    loads_or_is_refused(written(tmp_path, "\n".join(lines)))

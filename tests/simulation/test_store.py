"""What is kept survives, what is damaged is noticed, and nothing that is not ours is touched."""

import sqlite3
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import securestate as ss
from securestate.simulation import _store, campaign
from securestate.simulation._store import FILE, FileStore, Kept, MemoryStore, Store
from tests.simulation.campaigns import Counter, recipes, saved, scenarios

ROWS = [
    Kept("a", 0, 10, b"\0\1\2", "", 1.5),
    Kept("a", 1, 5, b"five", "", None),
    Kept("a", 1, 10, b"ten", "", None),
    Kept("b", 0, 10, b"", "no — not this plant", float("inf")),
]


@pytest.fixture(params=["memory", "file"])
def store(request: pytest.FixtureRequest, tmp_path: Path) -> Store:
    return MemoryStore() if request.param == "memory" else FileStore(tmp_path)


def test_a_store_gives_back_what_it_was_given_in_order_and_the_last_word_counts(store: Store) -> None:
    store.put([ROWS[2], ROWS[0]])
    store.put(ROWS)
    assert store.get("a") == ROWS[:3]
    assert store.get("b") == ROWS[3:]
    assert store.get("c") == []
    again = Kept("a", 0, 10, b"again", "", 0.1)
    store.put([again])
    assert store.get("a") == [again, *ROWS[1:3]]
    store.close()


def test_a_file_is_found_again(tmp_path: Path) -> None:
    first = FileStore(tmp_path)
    first.put(ROWS)
    first.close()
    second = FileStore(tmp_path)
    assert second.get("a") == ROWS[:3]
    second.close()
    assert [path.name for path in tmp_path.iterdir()] == [FILE]


def test_what_stops_a_transaction_undoes_all_of_it_and_the_store_goes_on(tmp_path: Path) -> None:
    store = FileStore(tmp_path)

    def stopped() -> object:
        yield ROWS[0]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        store.put(stopped())  # type: ignore[arg-type]
    with pytest.raises(KeyboardInterrupt), store._transaction():
        store._db.execute("DELETE FROM results")
        raise KeyboardInterrupt
    assert store.get("a") == []
    store.put(ROWS)
    assert store.get("a") == ROWS[:3]
    store.close()


def test_two_comparisons_in_one_folder_disturb_each_other_in_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_store, "PATIENCE", 0.05)
    refused = []

    def meanwhile(done: int, total: int) -> None:
        if 0 < done < total and not refused:
            with pytest.raises(ss.InputError, match="out: expected no other comparison at work") as caught:
                campaign(scenarios(20), recipes(), out=tmp_path / "out")
            refused.append(str(caught.value))

    monkeypatch.setattr("securestate.simulation._campaign.BUNDLE", 1)
    result = campaign(scenarios(20), recipes(), workers=1, out=tmp_path / "out", progress=meanwhile)
    assert len(refused) == 1
    assert FILE in refused[0]
    expected = campaign(scenarios(20), recipes())
    assert saved(result, tmp_path / "one") == saved(expected, tmp_path / "two")


@pytest.mark.parametrize("content", [b"no database at all", b"SQLite format 3\0" + b"x" * 4000, b"\0" * 8192])
def test_a_file_that_is_no_database_is_left_as_it_is(tmp_path: Path, content: bytes) -> None:
    (tmp_path / FILE).write_bytes(content)
    with pytest.raises(ss.InputError, match="out: expected a folder with sound results, or without any"):
        campaign(scenarios(5)[:1], recipes(), out=tmp_path)
    assert (tmp_path / FILE).read_bytes() == content
    assert [path.name for path in tmp_path.iterdir()] == [FILE]


@pytest.mark.parametrize("statement", ["CREATE TABLE mine (x)", "PRAGMA user_version = 7"])
def test_somebody_elses_database_is_left_as_it_is(tmp_path: Path, statement: str) -> None:
    other = sqlite3.connect(tmp_path / FILE)
    other.execute(statement)
    other.close()
    before = (tmp_path / FILE).read_bytes()
    with pytest.raises(ss.InputError, match="out: expected results of layout"):
        campaign(scenarios(5)[:1], recipes(), out=tmp_path)
    assert (tmp_path / FILE).read_bytes() == before


def test_a_place_that_cannot_be_written_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("in the way")
    for place in ("file", "file/below"):
        with pytest.raises(ss.InputError, match="out: expected a folder that can be written"):
            campaign(scenarios(5)[:1], recipes(), out=tmp_path / place)
    (tmp_path / "folder" / FILE).mkdir(parents=True)
    with pytest.raises(ss.InputError, match="out: expected a folder that can be written"):
        campaign(scenarios(5)[:1], recipes(), out=tmp_path / "folder")


def test_a_full_disk_is_told_and_what_is_kept_stays(tmp_path: Path) -> None:
    store = FileStore(tmp_path)
    store.put(ROWS)
    store._db.execute("PRAGMA max_page_count = 3")
    with pytest.raises(ss.InputError, match="out: expected a disk with space left"):
        store.put([Kept("big", 0, 10, bytes(100_000), "", None)])
    assert store.get("a") == ROWS[:3]
    assert store.get("big") == []
    store.close()


def test_a_number_that_was_changed_is_noticed(tmp_path: Path) -> None:
    store = FileStore(tmp_path)
    store.put(ROWS)
    store._db.execute("UPDATE results SET runs = 9 WHERE runs = 5")
    with pytest.raises(ss.InputError, match=r"sound results.*damaged"):
        store.get("a")
    assert store.get("b") == ROWS[3:]
    store.close()


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, dict[str, bytes]]:
    """The file of a finished comparison, and what it is saved as."""
    folder = tmp_path_factory.mktemp("finished")
    result = campaign(scenarios(12)[:2], recipes()[:1], out=folder)
    return (folder / FILE).read_bytes(), saved(result, folder)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_damaged_file_is_refused_or_gives_the_same_result(
    tmp_path_factory: pytest.TempPathFactory, finished: tuple[bytes, dict[str, bytes]], data: st.DataObject
) -> None:
    folder, (sound, expected) = tmp_path_factory.mktemp("damaged"), finished
    content = bytearray(sound)
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(content) - 1))
        content[at : at + 8] = data.draw(st.binary(min_size=0, max_size=8))
    if data.draw(st.booleans()):
        del content[data.draw(st.integers(0, len(content))) :]
    (folder / FILE).write_bytes(content)
    try:
        result = campaign(scenarios(12)[:2], recipes()[:1], out=folder)
    except ss.InputError as refusal:
        assert refusal.argument == "out"
    else:
        assert saved(result, folder) == expected


def test_a_killed_writer_leaves_a_file_that_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The copy of file and journal in the middle of a transaction is what a crash leaves."""
    (tmp_path / "live").mkdir()
    store = FileStore(tmp_path / "live")
    store.put(ROWS)
    store._db.execute("PRAGMA cache_size = 1")
    crash = tmp_path / "crash"
    crash.mkdir()
    with pytest.raises(KeyboardInterrupt), store._transaction():
        for i in range(50):
            store._db.execute("INSERT INTO results VALUES (?, 0, 0, ?, '', NULL, 0)", (str(i), bytes(4000)))
        for path in (tmp_path / "live").iterdir():
            (crash / path.name).write_bytes(path.read_bytes())
        raise KeyboardInterrupt
    store.close()
    assert len(list(crash.iterdir())) == 2
    again = FileStore(crash)
    assert again.get("a") == ROWS[:3]
    assert again.get("1") == []
    again.close()
    counter = Counter(monkeypatch)
    campaign(scenarios(5)[:1], recipes(), out=crash)
    assert len(counter.done) == 3

"""A folder with a plant and files of measurements, and a command line run in it."""

import shutil
from pathlib import Path

import pytest

from securestate.cli import execute
from tests.cli.helpers import PLANT, Command, Outcome, measurements


@pytest.fixture(scope="session")
def originals(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `folder` is a copy of."""
    path = tmp_path_factory.mktemp("originals")
    PLANT.save(path / "plant.toml")
    frame = measurements(300)
    frame.to_csv(path / "honest.csv", index=False)
    frame.loc[100:, "flow 2"] += 8
    frame.to_csv(path / "lying.csv", index=False)
    return path


@pytest.fixture
def folder(originals: Path, tmp_path: Path) -> Path:
    """A folder with plant.toml, honest.csv and lying.csv: flow 2 adds 8 from sample 100 on."""
    shutil.copytree(originals, tmp_path, dirs_exist_ok=True)
    return tmp_path


@pytest.fixture
def command(folder: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Command:
    """Run a command line in the folder."""
    monkeypatch.chdir(folder)

    def run(*arguments: str) -> Outcome:
        code = execute(arguments)
        return Outcome(int(code), *capfd.readouterr())

    return run

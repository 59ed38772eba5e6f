"""The command line as its own process: terminals, pipes, encodings, signals."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import securestate as ss
from securestate.cli import execute
from tests.cli.helpers import PLANT, measurements

# A shell may have told its children to ignore Ctrl-C; a user's terminal does not.
START = "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); {}; sys.exit(main())"
PLAIN = START.format("from securestate.cli import main")
# Ten milliseconds per block make a job long enough to be hit in the middle, and a line says when that is.
SLOW = START.format(
    "from securestate.cli import job, main; import time; job.BLOCK = 1; "
    "run = job.Run.concat; start = job.run_in_blocks; "
    "job.run_in_blocks = lambda e, d, first, covariance, advance: start("
    "e, d, first, covariance=covariance, advance=lambda n: (print('step', flush=True), time.sleep(0.01)))"
)


def process(code: str, folder: Path, *arguments: str, **variables: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        cwd=folder,
        env=os.environ | variables,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        encoding="utf-8",
    )


ESTIMATE = ("estimate", "--plant", "plant.toml", "--data", "lying.csv")


def test_output_into_a_pipe_has_no_control_characters_whatever_the_encoding(folder: Path) -> None:
    running = process(PLAIN, folder, *ESTIMATE, PYTHONIOENCODING="ascii", NO_COLOR="1")
    out, err = running.communicate(timeout=60)
    assert running.returncode == 3, err
    assert err == ""
    assert out.isascii()
    assert all(character.isprintable() or character == "\n" for character in out)
    assert "flow 2" in out


def test_the_module_runs_as_the_command_does(folder: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "securestate", "--version"],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert done.stdout.startswith("securestate 0.")


def test_a_reader_that_leaves_early_gets_no_traceback(folder: Path) -> None:
    running = process(PLAIN, folder, *ESTIMATE)
    assert running.stdout is not None
    assert running.stderr is not None
    running.stdout.close()
    assert running.stderr.read() == ""
    assert running.wait(timeout=60) == 1
    running.stderr.close()


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGKILL, -signal.SIGKILL)]
)
def test_a_job_stopped_in_the_middle_leaves_the_old_files_as_they_were(
    folder: Path, number: signal.Signals, code: int
) -> None:
    (folder / "states.csv").write_text("old")
    before = {path.name for path in folder.iterdir()}
    running = process(SLOW, folder, *ESTIMATE, "--out", "states.csv", "--report", "report.html")
    assert running.stdout is not None
    for _ in range(5):
        assert running.stdout.readline() == "step\n"
    running.send_signal(number)
    _, err = running.communicate(timeout=60)
    assert running.returncode == code
    assert "Traceback" not in err
    assert (folder / "states.csv").read_text() == "old"
    assert {path.name for path in folder.iterdir()} == before


def test_usage_without_a_command_shows_help(capfd: pytest.CaptureFixture[str]) -> None:
    assert execute([]) == 2
    out, err = capfd.readouterr()
    assert "estimate" in out
    assert err == ""


def test_help_tells_the_exit_codes(capfd: pytest.CaptureFixture[str]) -> None:
    assert execute(["estimate", "--help"]) == 0
    out = capfd.readouterr().out
    assert "3 at least one sensor lies" in " ".join(out.split())


def test_a_long_file_is_estimated_in_seconds(tmp_path: Path) -> None:
    PLANT.save(tmp_path / "plant.toml")
    measurements(100_000).to_csv(tmp_path / "long.csv", index=False)
    start = time.perf_counter()
    arguments = ("--plant", str(tmp_path / "plant.toml"), "--data", str(tmp_path / "long.csv"), "--quiet")
    assert execute(["estimate", *arguments, "--out", str(tmp_path / "out.parquet")]) == 0
    assert time.perf_counter() - start < 30
    assert ss.Plant.load(tmp_path / "plant.toml") == PLANT

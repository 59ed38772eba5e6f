"""The command line: `securestate estimate`, `identify`, `judge`, `analyse`, `compare`, `plant check`."""

from __future__ import annotations

import signal
import sys
import warnings
from collections.abc import Callable, Sequence
from functools import cache
from importlib.metadata import version
from types import FrameType
from typing import Annotated, Any, NoReturn

import typer

from securestate.cli import analyse, compare, estimate, identify, judge, plant
from securestate.cli.exits import HELP, HELP_BEFORE_DATA, HELP_OF_A_MODEL, HELP_WITHOUT_LIARS, Exit, outcome

app = typer.Typer(
    help="Estimate the state of a plant while some of its sensors lie, and name the liars.",
    epilog=HELP,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
plants = typer.Typer(help="Look at a plant before any data.", no_args_is_help=True)
app.command("estimate", epilog=HELP)(estimate.estimate)
app.command("identify", epilog=HELP_OF_A_MODEL)(identify.identify)
app.command("judge", epilog=HELP_OF_A_MODEL)(judge.judge)
app.command("analyse", epilog=HELP_BEFORE_DATA)(analyse.analyse)
app.command("compare", epilog=HELP_WITHOUT_LIARS)(compare.compare)
plants.command("check", epilog=HELP)(plant.check)
app.add_typer(plants, name="plant")


def _show_version(wanted: bool) -> None:
    if wanted:
        print(f"securestate {version('securestate')}")
        raise typer.Exit


@app.callback()
def _options(
    show_version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version and stop."),
    ] = False,
) -> None:
    """Take the options that stand before a command."""


def main() -> int:
    """Run the command line of this process and return its exit code."""
    signal.signal(signal.SIGTERM, _terminated)
    return execute(sys.argv[1:])


def execute(arguments: Sequence[str]) -> Exit:
    """Run one command line and return its exit code."""
    with warnings.catch_warnings():
        warnings.showwarning = _warn  # one line, without the place in our code
        return outcome(lambda: _command()(list(arguments), prog_name="securestate", standalone_mode=False))


@cache
def _command() -> Callable[..., object]:
    """The whole command; typer takes longer to build it than most commands take to run."""
    return typer.main.get_command(app)


def _warn(message: Warning | str, *_: Any, **__: Any) -> None:
    print(f"warning: {message}", file=sys.stderr)


def _terminated(signum: int, _: FrameType | None) -> NoReturn:
    raise SystemExit(128 + signum)  # so that unfinished files are removed

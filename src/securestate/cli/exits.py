"""Exit codes, and which outcome of a command has which."""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Callable
from enum import IntEnum

import typer

from securestate.errors import DesignError, SecurestateError


class Exit(IntEnum):
    """What the command line tells a script."""

    CLEAN = 0  # done; no sensor lies
    INTERNAL = 1  # a bug of securestate
    INPUT = 2  # bad usage, or a file that is wrong or cannot be read or written
    SUSPECTED = 3  # done; at least one sensor lies persistently (`Summary.liars`)
    DESIGN = (
        4  # the plant does not allow the method, or survives fewer liars than asked; a model is inadequate
    )
    INTERRUPTED = 130  # by the user


HELP = (
    "Exit codes: 0 no sensor lies · 1 internal error · 2 bad usage or bad input · "
    "3 at least one sensor lies · 4 the plant does not allow the method · 130 interrupted."
)


HELP_BEFORE_DATA = (
    "Exit codes: 0 done · 1 internal error · 2 bad usage or bad input · "
    "4 the plant does not survive that · 130 interrupted."
)

HELP_OF_A_MODEL = (
    "Exit codes: 0 the model is good or usable · 1 internal error · 2 bad usage or bad input · "
    "4 the model is inadequate · 130 interrupted."
)

HELP_WITHOUT_LIARS = "Exit codes: 0 done · 1 internal error · 2 bad usage or bad input · 130 interrupted."


def outcome(command: Callable[[], object]) -> Exit:
    """Run a command, turn every way it can end into an exit code, and tell problems on stderr."""
    try:
        result = command()
        sys.stdout.flush()
    except DesignError as error:
        complain(error.reason)
        if error.advice:
            print(f"advice: {error.advice}", file=sys.stderr)
        return Exit.DESIGN
    except (SecurestateError, OSError) as error:
        return _unusable(error)
    except (KeyboardInterrupt, typer.Abort):
        return _interrupted()
    except Exception as error:  # whatever else comes is a usage error of typer, or a bug
        return _usage_or_bug(error)
    if result == Exit.INTERRUPTED:  # newer versions of typer catch Ctrl-C themselves
        return _interrupted()
    return Exit(result) if isinstance(result, int) else Exit.CLEAN


def complain(problem: str) -> None:
    """Tell a problem on stderr."""
    print(f"error: {problem}", file=sys.stderr)


def _interrupted() -> Exit:
    complain("interrupted; no file was changed by halves")
    return Exit.INTERRUPTED


def _unusable(error: Exception) -> Exit:
    if isinstance(error, BrokenPipeError):  # the reader of our output, such as `head`, has gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return Exit.INTERNAL
    complain(str(error))
    return Exit.INPUT


def _usage_or_bug(error: Exception) -> Exit:
    told = getattr(error, "format_message", None)  # typer's own errors; it does not export their base class
    if callable(told):
        if problem := told():  # empty where help was shown instead
            complain(f"{problem} (try --help)")
        return Exit.INPUT
    traceback.print_exc()
    complain("this is a bug of securestate; please report it with the lines above")
    return Exit.INTERNAL

"""`securestate estimate`: from a plant file and a measurement file to states, liars and a report."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from securestate.cli.exits import Exit
from securestate.estimators.registry import AUTO, DEFAULT, METHODS


class Form(StrEnum):
    """Which form of sparse fusion, joint fusion or the innovation mixture."""

    ROBUST = "robust"
    PAPER = "paper"
    EXACT = "exact"
    PRINTED = "printed"
    PROPAGATION = "propagation"
    BELIEF = "belief"


class Memory(StrEnum):
    """What the innovation mixture remembers of a sensor."""

    RATE = "rate"
    DOUBT = "doubt"
    STICKY = "sticky"


class Protected(StrEnum):
    """Who counts as protected in joint fusion."""

    MARKED = "marked"
    AUTO = "auto"


class Fusion(StrEnum):
    """How joint fusion weighs local estimates."""

    OPTIMAL = "optimal"
    AVERAGE = "average"
    COVARIANCE_INTERSECTION = "covariance-intersection"


class Scope(StrEnum):
    """What the chi-square test looks at."""

    SENSOR = "sensor"
    CENTRAL = "central"


class OnAlarm(StrEnum):
    """What the chi-square detector does about an alarm."""

    DROP = "drop"
    HOLD = "hold"
    PREDICT = "predict"
    DROP_WORST = "drop-worst"


class Init(StrEnum):
    """Where the mean of the honest component starts."""

    SPLIT = "split"
    MEDIAN = "median"
    MEAN = "mean"
    PREDICTION = "prediction"


class Mean(StrEnum):
    """How the points of the honest component are averaged."""

    PRINTED = "printed"
    PRECISION = "precision"


class Floor(StrEnum):
    """What keeps the covariance of the attacked component away from zero."""

    PRINTED = "printed"
    PRIOR = "prior"


class Prior(StrEnum):
    """What is known before the first sample."""

    STEADY_STATE = "steady-state"
    WINDOW = "window"


def _known(name: str) -> str:
    if name not in NAMES:
        raise typer.BadParameter(f"{name!r} is none of {', '.join(NAMES)}")
    return name


#: What --method takes, and the methods that state a rate of false alarms.
NAMES = (AUTO, *METHODS)
RATED = tuple(name for name, method in METHODS.items() if "false_alarm_rate" in method.settings)


def _number_or_word(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def estimate(
    plant: Annotated[Path, typer.Option(help="Plant file, TOML.")],
    data: Annotated[Path, typer.Option(help="Measurements: .csv, .tsv, .parquet or .nc.")],
    method: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            callback=_known,
            autocompletion=lambda: list(NAMES),
            help=f"{AUTO} stands for {DEFAULT} and is the one to try first; "
            + "; ".join(f"{name} {known.summary}" for name, known in METHODS.items())
            + ".",
        ),
    ] = AUTO,
    prior: Annotated[
        Prior,
        typer.Option(
            help="steady-state: it starts near the operating point (default); window: anywhere, and "
            "its first samples are solved together."
        ),
    ] = Prior.STEADY_STATE,
    kalman_probability: Annotated[
        float | None,
        typer.Option(help="sparse: how often an honest step equals the Kalman filter, in (0, 1)."),
    ] = None,
    gamma: Annotated[
        float | None, typer.Option(help="sparse: weight of the penalty, instead of the probability.")
    ] = None,
    form: Annotated[
        Form | None,
        typer.Option(
            help="sparse: robust (default) or paper; joint: exact (default) or printed; "
            "innovation-mixture: propagation (default) or belief."
        ),
    ] = None,
    refit: Annotated[
        bool | None,
        typer.Option(
            "--refit/--no-refit", help="sparse: estimate again without the shrinkage.", show_default=False
        ),
    ] = None,
    false_alarm_rate: Annotated[
        float | None,
        typer.Option(help=f"{', '.join(RATED)}: how often a sample of an honest sensor raises an alarm."),
    ] = None,
    calibrate_on: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE",
            help="bias-monitor: a record without lies that the model was not fitted to; several times.",
        ),
    ] = None,
    run_length: Annotated[
        float | None,
        typer.Option(help="bias-monitor: samples between two false alarms on average (default: 1000)."),
    ] = None,
    scope: Annotated[
        Scope | None, typer.Option(help="chi-square: each sensor alone (default), or all at once.")
    ] = None,
    on_alarm: Annotated[
        OnAlarm | None,
        typer.Option(help="chi-square: drop (default) or hold; central: predict (default) or drop-worst."),
    ] = None,
    window: Annotated[
        int | None,
        typer.Option(help="adaptive-joint, joint: samples over which lies are averaged (default: 20)."),
    ] = None,
    gate: Annotated[
        float | None,
        typer.Option(help="adaptive-joint, joint: nu²/S above which a sample counts at once (default: 9)."),
    ] = None,
    eta: Annotated[
        str | None,
        typer.Option(
            metavar="VARIANCE|adaptive",
            help="joint: variance assumed of an injection, (sensor unit)² (default: 1), or adaptive.",
        ),
    ] = None,
    protected: Annotated[
        Protected | None,
        typer.Option(help="joint: sensors marked in the plant file (default), or those a gate trusts."),
    ] = None,
    fusion: Annotated[
        Fusion | None, typer.Option(help="joint: how local estimates are weighed (default: optimal).")
    ] = None,
    square_root: Annotated[
        bool | None,
        typer.Option("--square-root", help="joint: keep covariances as factors.", show_default=False),
    ] = None,
    memory: Annotated[
        Memory | None,
        typer.Option(
            help="innovation-mixture: how often a sensor lied (rate, default; doubt), or habits (sticky)."
        ),
    ] = None,
    monitor: Annotated[
        float | None,
        typer.Option(
            help="innovation-mixture: looks for small biases; forgetting in (0, 1) (default: none)."
        ),
    ] = None,
    kappa: Annotated[
        float | None,
        typer.Option(help="innovation-mixture: variance expected of a false innovation (default: 5)."),
    ] = None,
    epsilon: Annotated[
        str | None,
        typer.Option(
            metavar="SHARE|none",
            help="mixture: mean belief in an attack above which all beliefs are swapped (default: 0.5).",
        ),
    ] = None,
    init: Annotated[
        Init | None, typer.Option(help="mixture: where the honest mean starts (default: split).")
    ] = None,
    literal: Annotated[
        bool | None,
        typer.Option("--literal", help="mixture: (22d) as printed; errors explode.", show_default=False),
    ] = None,
    start: Annotated[
        int | None, typer.Option(help="mixture: samples before which everybody is believed (default: 0).")
    ] = None,
    mean: Annotated[
        Mean | None, typer.Option(help="mixture: the honest mean as printed (default) or precision-weighted.")
    ] = None,
    floor: Annotated[
        Floor | None, typer.Option(help="mixture: least covariance of the attacked (default: printed).")
    ] = None,
    feedback: Annotated[
        bool | None,
        typer.Option(
            "--feedback", help="mixture: local filters start from the fused prediction.", show_default=False
        ),
    ] = None,
    cap: Annotated[
        int | None, typer.Option(help="mixture: iterations per sample at most (default: 100).")
    ] = None,
    allow_missing: Annotated[
        bool, typer.Option("--allow-missing", help="Channels without a column count as missing throughout.")
    ] = False,
    hold_inputs: Annotated[
        bool, typer.Option("--hold-inputs", help="Inputs that are missing keep their last value.")
    ] = False,
    time_column: Annotated[
        str | None, typer.Option(metavar="NAME", help="Name of the time column (default: time).")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Write the estimates: .csv, .parquet or .nc.")] = None,
    report: Annotated[Path | None, typer.Option(help="Write the report: one .html file.")] = None,
    findings: Annotated[
        Path | None,
        typer.Option(help="Write who lies, when, how much and how sure: one .json file for programs."),
    ] = None,
    covariance: Annotated[
        bool, typer.Option("--covariance", help="Write covariances too; only into a .nc file.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")] = False,
    exit_zero: Annotated[
        bool, typer.Option("--exit-zero", help="End with 0, not 3, if a sensor lies.")
    ] = False,
) -> Exit:
    """Estimate the state from measurements, name the sensors that lie and what they inject.

    A sensor lies if at least half of some 20 samples in a row that it sent are suspected. Files are written
    whole or not at all; an existing file is replaced at the end.
    """
    from securestate.cli.job import Order, run_order  # the scientific libraries take a second to import

    choices = {
        "kalman_probability": kalman_probability,
        "gamma": gamma,
        "form": None if form is None else form.value,
        "refit": refit,
        "false_alarm_rate": false_alarm_rate,
        "run_length": run_length,
        "calibrate_on": calibrate_on or None,
        "scope": None if scope is None else scope.value,
        "on_alarm": None if on_alarm is None else on_alarm.value,
        "window": window,
        "gate": gate,
        "eta": None if eta is None else _number_or_word(eta),
        "protected": None if protected is None else protected.value,
        "fusion": None if fusion is None else fusion.value,
        "square_root": square_root or None,
        "memory": None if memory is None else memory.value,
        "monitor": monitor,
        "kappa": kappa,
        "epsilon": None if epsilon is None else _number_or_word(epsilon),
        "init": None if init is None else init.value,
        "literal": literal or None,
        "start": start,
        "mean": None if mean is None else mean.value,
        "floor": None if floor is None else floor.value,
        "feedback": feedback or None,
        "cap": cap,
    }
    return run_order(
        Order(
            plant=plant,
            data=data,
            method=method,
            from_window=prior is Prior.WINDOW,
            choices={name: value for name, value in choices.items() if value is not None},
            time_column=time_column,
            allow_missing=allow_missing,
            hold_inputs=hold_inputs,
            out=out,
            report=report,
            findings=findings,
            covariance=covariance,
            quiet=quiet,
            exit_zero=exit_zero,
        )
    )

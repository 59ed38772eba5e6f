"""The main job: read, design, run in blocks, write, summarise."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from securestate._results import check_folder, check_result_path
from securestate._words import enumerate_names
from securestate.cli import console
from securestate.cli.exits import Exit
from securestate.cli.methods import design, refuse_foreign
from securestate.errors import InputError, SecurestateWarning
from securestate.estimators import ColdStart, Estimator, Run, cold_start, start_after, window_run
from securestate.measurements import Measurements, read_history, read_measurements, write_run
from securestate.plant import Plant
from securestate.reporting import summarise, write_findings, write_report
from securestate.reporting.beside import compare_runs

BLOCK = 1000  # samples between two looks at the progress bar and at Ctrl-C


@dataclass(frozen=True, kw_only=True)
class Order:
    """What the user asked for; `choices` are the settings of the method that were given."""

    plant: Path
    data: Path
    method: str
    from_window: bool
    choices: Mapping[str, object]
    time_column: str | None
    allow_missing: bool
    hold_inputs: bool
    out: Path | None
    report: Path | None
    findings: Path | None
    covariance: bool
    quiet: bool
    exit_zero: bool


def run_order(order: Order) -> Exit:
    """Do the whole job; nothing is written before every sample is estimated."""
    _check(order)
    plant = Plant.load(order.plant)
    data = read_measurements(
        order.data,
        plant,
        time_column=order.time_column,
        allow_missing=order.allow_missing,
        hold_inputs=order.hold_inputs,
    )
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always", SecurestateWarning)
        estimator = design(plant, order.method, _with_records(plant, order), given=order.from_window)
        first = cold_start(plant, data.y, data.u) if order.from_window else None
    other = estimator.beside if first or not (estimator.beside and estimator.beside.no_steady_state) else None
    with console.progress(len(data.y) * (1 if other is None else 2), quiet=order.quiet) as advance:
        run = run_in_blocks(estimator, data, first, covariance=order.covariance, advance=advance)
        beside = (
            None if other is None else run_in_blocks(other, data, first, covariance=False, advance=advance)
        )
    said = [
        *([] if first is None else window_remarks(first)),
        *(_sentence(str(one.message)) for one in warned),
        *remarks(data, estimator),
    ]
    written = _write(run, beside, said, order)
    summary = summarise(run)
    if not order.quiet:
        both = [] if beside is None else [compare_runs(run, beside).sentence]
        console.show_summary(run, summary, [*both, *said], written)
    return Exit.SUSPECTED if summary.liars and not order.exit_zero else Exit.CLEAN


def _with_records(plant: Plant, order: Order) -> Mapping[str, object]:
    """The choices, with what the files hold that a method is calibrated on."""
    files = order.choices.get("calibrate_on")
    if files is None:
        return order.choices
    assert isinstance(files, list)
    channels, inputs = plant.channel_names, plant.input_names
    clean = read_history(files, channels=channels, inputs=inputs, time_column=order.time_column, dt=plant.dt)
    records = [(y, u) if plant.n_inputs else y for y, u in clean.segments]
    return {**order.choices, "calibrate_on": records}


def run_in_blocks(
    estimator: Estimator,
    data: Measurements,
    first: ColdStart | None = None,
    *,
    covariance: bool,
    advance: Callable[[int], None],
) -> Run:
    """Run one filter over all samples, telling how many are done after every block.

    With a cold start its window is the first block, and the filter starts after it.
    """
    blocks = [] if first is None else [window_run(estimator, first, covariance=covariance)]
    done = 0 if first is None else first.samples
    advance(done)
    if done == len(data.y):
        return Run.concat(blocks).with_time(data.time)
    live = estimator.start() if first is None else start_after(estimator, first)
    for start in range(done, len(data.y), BLOCK):
        rows = slice(start, start + BLOCK)
        u = None if data.u is None else data.u[rows]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SecurestateWarning)  # `remarks` says it about the whole file
            blocks.append(live.run(data.y[rows], u, covariance=covariance))
        advance(len(blocks[-1].status))
    return Run.concat(blocks).with_time(data.time)


def window_remarks(first: ColdStart) -> list[str]:
    """Say what the cold start found."""
    names = np.array(first.plant.sensor_names)
    believed = (~first.suspected & ~np.isnan(first.trust)).any(axis=0)
    unchecked = np.atleast_2d(first.honest).any(axis=0) & ~believed
    parties = (
        ("believed", believed),
        ("heard without a check", unchecked),
        ("distrusted", first.suspected.any(axis=0)),
    )
    said = [f"{what}: {enumerate_names(tuple(names[who].tolist()))}" for what, who in parties if who.any()]
    window = _count(first.samples, "sample")
    start = f"No prior: the first {window} were solved together; {'; '.join(said) or 'nothing arrived'}."
    if first.certified:
        return [start]
    return [start, f"This start is NOT certified: {first.reason}. Give it no weight without another look."]


def remarks(data: Measurements, estimator: Estimator) -> list[str]:
    """Say in sentences what was done to the file's rows and columns."""
    said = []
    missing = float(np.isnan(data.y).mean())
    if estimator.missing_limit is not None and missing > estimator.missing_limit:
        said.append(f"{missing:.0%} of the samples are missing: --method kalman suits this file better.")
    if data.time is None:
        said.append("The file has no time column: its rows are taken as consecutive samples.")
    if data.gaps:
        said.append(
            f"{_count(data.gaps, 'sample')} inserted where the file has none; all channels missing there."
        )
    if 2 * data.gaps > len(data.y):
        said.append(
            f"Most samples are inserted: the plant asks for one every {estimator.plant.dt:g} s; check dt."
        )
    if data.held:
        said.append(f"{_count(data.held, 'sample')} with inputs held at their last known value.")
    if data.absent:
        said.append(f"No column for {', '.join(data.absent)}: missing throughout.")
    if data.extra:
        said.append(f"{_count(len(data.extra), 'column')} not used: {', '.join(data.extra)}.")
    return said


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}."


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}{'' if number == 1 else 's'}"


def _check(order: Order) -> None:
    """Refuse before any computing what cannot end well."""
    refuse_foreign(order.method, order.choices)
    if order.out is not None:
        check_result_path(order.out, "--out")
    if order.report is not None:
        if order.report.suffix.lower() not in (".html", ".htm"):
            raise InputError("--report", "a file name ending in .html", repr(str(order.report)))
        check_folder(order.report, "--report")
    if order.findings is not None:
        if order.findings.suffix.lower() != ".json":
            raise InputError("--findings", "a file name ending in .json", repr(str(order.findings)))
        check_folder(order.findings, "--findings")
    if order.covariance and (order.out is None or order.out.suffix.lower() != ".nc"):
        raise InputError(
            "--covariance", "--out with a .nc file, the only one that holds matrices", str(order.out)
        )
    _keep_inputs(order)


def _keep_inputs(order: Order) -> None:
    """Refuse to write over what is read, or twice over the same file."""
    taken = {path.resolve(): name for name, path in (("--plant", order.plant), ("--data", order.data))}
    outputs = (("--out", order.out), ("--report", order.report), ("--findings", order.findings))
    for name, path in outputs:
        if path is not None and path.resolve() in taken:
            raise InputError(name, f"another file than {taken[path.resolve()]}", repr(str(path)))


def _write(run: Run, beside: Run | None, said: list[str], order: Order) -> list[Path]:
    written, source = [], order.data.name
    if order.out is not None:
        write_run(run, order.out)
        written.append(order.out)
    if order.report is not None:
        written.append(write_report(run, order.report, source=source, notes=said, beside=beside))
    if order.findings is not None:
        written.append(write_findings(run, order.findings, source=source, notes=said))
    return written

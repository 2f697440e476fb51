"""The `cpid` command."""

import json
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from cpid_drake.errors import InputError

app = typer.Typer(
    name="cpid",
    help="Identify a captured target's inertial parameters from momentum conservation.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


@app.callback()
def _common() -> None:
    """Keep subcommands even while there is only one."""


@app.command()
def paper(
    out: Annotated[Path, typer.Option(help="Folder for figures and summary.json; made if needed.")],
    scenario: Annotated[
        str | None,
        typer.Option(metavar="FILE", help="Scenario to run instead of the paper's own."),
    ] = None,
    quiet: Annotated[
        bool, typer.Option("--quiet", help="Print no tables and no progress.")
    ] = False,
) -> None:
    """Run the study of Ning et al. 2016: simulate, identify, print its tables, draw its figures."""
    start = time.perf_counter()
    # Imported here so that `cpid --help` does not wait for Drake.
    from cpid_drake.report.paper import print_tables, write_figures
    from cpid_drake.scenario import load_scenario, shipped_scenario
    from cpid_drake.studies.paper import run_paper_study, summarize

    _make_folder(out)
    log = Console(stderr=True, quiet=quiet, markup=False)
    with log.status("reading the scenario") as status:

        def progress(step: str) -> None:
            status.update(step)

        study = run_paper_study(load_scenario(scenario or shipped_scenario("paper")), progress)
        progress("drawing the figures")
        files = write_figures(study, out)
    files.append(out / "summary.json")
    summary = summarize(study, time.perf_counter() - start)
    files[-1].write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    if not quiet:
        print_tables(study, Console(markup=False))
    log.print(f"\n{len(files)} files in {out}, {summary['wall_seconds']:.1f} s", highlight=False)


@app.command()
def accuracy(
    scenario: Annotated[
        str, typer.Argument(metavar="SCENARIO", help="A scenario file, or a shipped one's name.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for figures and summary.json; made if needed.")],
    trials: Annotated[
        int | None, typer.Option(help="Trials for each preset; default: the scenario's.")
    ] = None,
    preset: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Sensor preset or file; again for more than one."),
    ] = None,
    estimator: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Estimator; again for more than one. Default: all."),
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Seed; default: the scenario's.")] = None,
    jobs: Annotated[
        int | None, typer.Option(help="Processes; default: one for each processor.")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print no table and no progress.")] = False,
) -> None:
    """Try the estimators on noisy sensors many times: error, bound, bias, honesty of intervals."""
    start = time.perf_counter()
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    from cpid_drake.report.accuracy import print_table, write_figures
    from cpid_drake.scenario import load_scenario, shipped_scenario
    from cpid_drake.studies.accuracy import run_accuracy, summarize

    is_file = Path(scenario).suffix or "/" in scenario
    loaded = load_scenario(scenario if is_file else shipped_scenario(scenario))
    _make_folder(out)
    log = Console(stderr=True, quiet=quiet, markup=False)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, TimeRemainingColumn(), console=log, disable=not log.is_terminal) as bar:
        tasks = {}

        def progress(name: str, done: int, total: int) -> None:
            if name not in tasks:
                tasks[name] = bar.add_task(name, total=total)
            bar.update(tasks[name], completed=done)

        study = run_accuracy(
            loaded,
            trials=trials,
            presets=preset or (),
            estimators=estimator or (),
            seed=seed,
            jobs=(os.cpu_count() or 1) if jobs is None else jobs,
            progress=progress,
        )
    files = [*write_figures(study, out), out / "summary.json"]
    summary = {"scenario": scenario} | summarize(study, time.perf_counter() - start)
    files[-1].write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    if not quiet:
        print_table(study, Console(markup=False))
    log.print(f"\n{len(files)} files in {out}, {summary['wall_seconds']:.1f} s", highlight=False)


def _make_folder(path: Path) -> None:
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass  # a folder that cannot be written to is found out now, not after the work
    except OSError as error:
        raise InputError(f"--out {path}: cannot write there: {error.strerror}") from error


def main() -> None:
    """Run `cpid`; bad input or usage ends in one line on stderr and exit code 2."""
    try:
        code = app(standalone_mode=False)
    except InputError as error:
        code = _fail(str(error))
    except OSError as error:
        code = _fail(f"{error.filename or 'file'}: {error.strerror or error}")
    except KeyboardInterrupt:
        code = 130
    except Exception as error:
        # Usage errors: their class is Typer's or Click's, depending on Typer's version.
        if not hasattr(error, "format_message"):
            raise
        message = error.format_message()  # empty where the help has been printed instead
        code = _fail(message) if message else 2
    sys.exit(code or 0)


def _fail(message: str) -> int:
    print(f"cpid: error: {' '.join(message.split())}", file=sys.stderr)
    return 2

"""The subcommands of `cpid`, and its exit codes."""

import os
import sys
from typing import Annotated

import typer

from cpid_drake.commands.accuracy import accuracy
from cpid_drake.commands.export import export
from cpid_drake.commands.identify import identify
from cpid_drake.commands.listing import list_names, print_version
from cpid_drake.commands.paper import paper
from cpid_drake.commands.plan import plan
from cpid_drake.commands.report import report
from cpid_drake.commands.scenario import scenario
from cpid_drake.commands.simulate import simulate
from cpid_drake.commands.telemetry import telemetry
from cpid_drake.commands.validate import validate
from cpid_drake.commands.view import view
from cpid_drake.errors import InputError

EXIT_CODES = {
    0: "success",
    2: "bad input or usage, or an output that cannot be written",
    3: "the data do not determine all ten parameters",
    4: "a check of the answer failed",
    130: "interrupted",
}
"""The exit codes of all commands and their meanings."""

app = typer.Typer(
    name="cpid",
    help="Identify a captured target's inertial parameters from momentum conservation.",
    epilog="Exit codes: " + "; ".join(f"{code} {text}" for code, text in EXIT_CODES.items()) + ".",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


@app.callback()
def _common(
    version: Annotated[
        bool,
        typer.Option(
            "--version", is_eager=True, callback=print_version, help="Print the version and exit."
        ),
    ] = False,
) -> None:
    """Identify a captured target's inertial parameters from momentum conservation."""


app.command()(paper)
app.command()(identify)
app.command()(validate)
app.add_typer(telemetry, name="telemetry")
app.command()(simulate)
app.add_typer(plan, name="plan")
app.add_typer(scenario, name="scenario")
app.command()(accuracy)
app.command()(export)
app.command()(view)
app.command()(report)
app.command("list")(list_names)


def run() -> int:
    """Run `cpid` and return its exit code; see `EXIT_CODES`."""
    try:
        code = app(standalone_mode=False)
        sys.stdout.flush()  # a full disk is noticed here
        return code or 0
    except InputError as error:
        return _fail(str(error))
    except OSError as error:
        if not error.filename:  # not a file of the command: those errors are InputErrors
            _drop_output()
        return _fail(f"{error.filename or 'standard output'}: {error.strerror or error}")
    except typer.Abort as error:
        raise KeyboardInterrupt from error
    except Exception as error:
        # Usage errors: their class is Typer's or Click's, depending on Typer's version.
        if not hasattr(error, "format_message"):
            raise
        message = error.format_message()  # the message is empty if the help has been printed
        return _fail(message) if message else 2


def _drop_output() -> None:
    """Send the rest of standard output nowhere: the interpreter would fail again to write it."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _fail(message: str) -> int:
    print(f"cpid: error: {' '.join(message.split())}", file=sys.stderr)
    return 2

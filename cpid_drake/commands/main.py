"""The `cpid` command: its subcommands and exit codes."""

import os
import sys

import typer

from cpid_drake.commands.accuracy import accuracy
from cpid_drake.commands.export import export
from cpid_drake.commands.identify import identify
from cpid_drake.commands.paper import paper
from cpid_drake.commands.report import report
from cpid_drake.commands.scenario import scenario
from cpid_drake.commands.simulate import simulate
from cpid_drake.commands.telemetry import telemetry
from cpid_drake.commands.view import view
from cpid_drake.errors import InputError

app = typer.Typer(
    name="cpid",
    help="Identify a captured target's inertial parameters from momentum conservation.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.command()(paper)
app.command()(identify)
app.add_typer(telemetry, name="telemetry")
app.command()(simulate)
app.add_typer(scenario, name="scenario")
app.command()(accuracy)
app.command()(export)
app.command()(view)
app.command()(report)


def main() -> None:
    """Run `cpid`; bad input or usage causes one line on stderr and exit code 2."""
    # The matrices are small: BLAS threads only wait for each other. NumPy, here and in child
    # processes, reads these variables when it is imported, which is later.
    for library in ("OPENBLAS", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
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
        message = error.format_message()  # the message is empty if the help has been printed
        code = _fail(message) if message else 2
    sys.exit(code or 0)


def _fail(message: str) -> int:
    print(f"cpid: error: {' '.join(message.split())}", file=sys.stderr)
    return 2

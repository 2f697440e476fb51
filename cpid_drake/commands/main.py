"""The `cpid` command: its subcommands, its exit codes and its end."""

import codecs
import locale
import logging
import os
import platform
import sys
import unicodedata
from importlib import import_module
from io import TextIOWrapper
from typing import Annotated, Any

import typer
import typer.core
import typer.main

from cpid_drake.commands.usage import group
from cpid_drake.files.errors import InputError
from cpid_drake.files.resources import __version__, version_of

COMMANDS = {
    "identify": "Identify the target that a spacecraft holds from logs of its motion.",
    "simulate": "Simulate a scenario; write the log of its sensors and the true parameters.",
    "live": "Identify from samples as they arrive.",
    "plan": "Plan the joint motion that determines the target best; rank motions; export one.",
    "validate": "Test an identified target with another log, and predict this log.",
    "export": "Export an identified target as a model: URDF, SDF, MJCF or Drake model directives.",
    "report": "Write the report of an identification or of a simulated run, one HTML page.",
    "view": "Show the simulation of a scenario live in the browser, or write its replay.",
    "log": "Check logs, find out what their columns mean, and convert them.",
    "campaign": "Run many simulated trials, and report their errors.",
    "list": "List the shipped scenarios and sensors, the estimators and their row families.",
}
"""The subcommands and what they do; each is an object in the module of its name."""

EXIT_CODES = {
    0: "success",
    2: "bad input or usage, or an output that cannot be written",
    3: "the data do not determine all that can act on the motion",
    4: "a check failed",
    130: "interrupted",
}
"""The exit codes of all commands and their meanings."""


class LazyGroup(typer.core.TyperGroup):
    """Imports a subcommand only when it is used: Drake, SciPy and Matplotlib take a second."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all subcommands."""
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a stand-in of a subcommand, which has its name and its help."""
        if cmd_name not in COMMANDS:
            return None
        return typer.core.TyperCommand(cmd_name, help=COMMANDS[cmd_name])

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the name of the subcommand, the subcommand itself, and its arguments."""
        name, found, rest = super().resolve_command(ctx, args)
        if found is None:
            return name, found, rest
        command = getattr(import_module(f"cpid_drake.commands.{name}"), str(name))
        logging.getLogger("drake").setLevel(logging.WARNING)  # Drake sets it when it is imported
        if not isinstance(command, typer.Typer):
            command = group("", **{str(name): command})
        return name, typer.main.get_command(command), rest


app = typer.Typer(
    name="cpid",
    cls=LazyGroup,
    help="Identify a captured target's inertial parameters from momentum conservation.",
    epilog="Exit codes: " + "; ".join(f"{code} {text}" for code, text in EXIT_CODES.items()) + ".",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


def print_version(wanted: bool) -> None:
    """Print the versions of this package, Drake and Python, and exit, if this is wanted."""
    if wanted:
        drake = version_of("drake") or "not installed"
        print(f"cpid {__version__} (Drake {drake}, Python {platform.python_version()})")
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool,
        typer.Option(
            "--version", is_eager=True, callback=print_version, help="Print the version and exit."
        ),
    ] = False,
) -> None:
    pass


_PLAIN = {
    "²": "^2",
    "³": "^3",
    "·": "*",
    "±": "+-",
    "°": " deg",
    "σ": "sigma",
    "χ": "chi",
    "µ": "u",
}
_PLAIN |= {
    "→": "->",
    "…": "...",
    "√": "sqrt",
    "−": "-",
    "×": "x",
    "≤": "<=",
    "≥": ">=",
    "Δ": "delta",
}
_PLAIN |= {"–": "-", "—": "-", "─": "-", "∞": "inf", "ψ": "psi", "ω": "omega", "≈": "~"}


def _plain(error: UnicodeError) -> tuple[str, int]:
    """Replace what a terminal cannot show by what it can."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    text = error.object[error.start : error.end]
    found = "".join(_PLAIN.get(c, unicodedata.normalize("NFKD", c)) for c in text)
    kept = "".join(c for c in found if not unicodedata.combining(c))
    return kept.encode("ascii", "replace").decode(), error.end


def main() -> None:
    """Run `cpid` and exit with a code of `EXIT_CODES`; an error is one line on stderr."""
    codecs.register_error("plain", _plain)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="plain")
    try:
        if codecs.lookup(locale.getpreferredencoding(False)).name == "ascii":
            raise InputError("Drake cannot read its files in an ASCII locale; set PYTHONUTF8=1")
        code = app(standalone_mode=False) or 0
        sys.stdout.flush()  # a full disk is noticed here
    except InputError as error:
        code = _fail(str(error))
    except OSError as error:
        if not error.filename:  # standard output; the interpreter would fail again to write it
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = _fail(f"{error.filename or 'standard output'}: {error.strerror or error}")
    except (KeyboardInterrupt, typer.Abort):
        code = 130
    except Exception as error:
        # Usage errors: their class is Typer's or Click's, depending on Typer's version.
        if not hasattr(error, "format_message"):
            raise
        message = error.format_message()  # empty if the help has been printed
        code = _fail(message) if message else 2
    if code == 130:  # also what Typer makes of an interrupt
        print("cpid: interrupted", file=sys.stderr)
    sys.exit(code)


def _fail(message: str) -> int:
    print(f"cpid: error: {' '.join(message.split())}", file=sys.stderr)
    return 2

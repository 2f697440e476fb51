"""The `cpid` command: its subcommands, its exit codes and its end."""

import codecs
import locale
import logging
import os
import platform
import sys
from io import TextIOWrapper
from typing import Literal, get_args

from cyclopts import App, ArgumentCollection, CycloptsError, UnusedCliTokensError

from cpid_drake.commands.groups import group
from cpid_drake.files.errors import InputError
from cpid_drake.files.resources import __version__, version_of

COMMANDS = {
    "identify": "Identify the target that a spacecraft holds from logs of its motion.",
    "simulate": "Simulate a scenario; write the log of its sensors and the true parameters.",
    "live": "Identify from samples as they arrive.",
    "plan": "Plan an exciting joint motion; rank motions; export one.",
    "validate": "Test an identified target with another log, and predict this log.",
    "compare": "Compare results: whether they have the same target, and what differs.",
    "export": "Export an identified target as a model: URDF, SDF, MJCF or Drake model directives.",
    "report": "Write the report of an identification or of a simulated run, one HTML page.",
    "view": "Show the simulation of a scenario live in the browser, or write its replay.",
    "log": "Check logs; find out what their columns mean, and their noise.",
    "campaign": "Run many simulated trials, and report their errors.",
    "spacecraft": "Show what a model file offers as a spacecraft: base, frames, joints, masses.",
    "list": "List the shipped scenarios and sensors, the estimators and their row families.",
}
"""The subcommands and what they do; each is an object in the module NAME_command."""

EXIT_CODES = {
    0: "success",
    2: "bad input or usage, or an output that cannot be written",
    3: "not all parameters that can act on the motion are identifiable; "
    "a comparison is not decided",
    4: "a check failed",
    130: "interrupted",
    141: "the reader of the output has ended",
}
"""The exit codes of all commands and their meanings."""


def print_version() -> str:
    """Return the versions of this package, Drake and Python."""
    drake = version_of("drake") or "not installed"
    return f"cpid {__version__} (Drake {drake}, Python {platform.python_version()})"


def _whole_numbers(app: App, commands: tuple[str, ...], arguments: ArgumentCollection) -> None:
    """Refuse fractions where whole numbers are meant; cyclopts rounds them."""
    for each in arguments:
        if int in (each.hint, *get_args(each.hint)):
            for token in (token for token in each.tokens if "." in token.value):
                raise InputError(f"{token.keyword} {token.value}: give a whole number")


app = group(
    "cpid",
    help="Identify a captured target's inertial parameters from momentum conservation.\n\n"
    f"Exit codes: {'; '.join(f'{code} {text}' for code, text in EXIT_CODES.items())}.",
    version=print_version,
    config=_whole_numbers,
    exit_on_error=False,
    print_error=False,
)


@app.command(name="--install-completion")
def install_completion(
    *, shell: Literal["bash", "zsh", "fish", "powershell"] | None = None
) -> None:
    """Complete commands and options in your shell.

    Args:
        shell: Default: the shell in which the command runs.

    """
    from cyclopts.completion.detect import ShellDetectionError

    try:
        script = app.install_completion(shell=shell)
    except ShellDetectionError as error:
        raise InputError(f"the shell is not known; give --shell: {error}") from error
    files, text = "COMPREPLY=( $(compgen -f", script.read_text(encoding="utf-8")
    # Bash continues the name of a folder if the words are declared to be names of files.
    text = text.replace(files, f"compopt -o filenames 2> /dev/null; {files}")
    script.write_text(text, encoding="utf-8")
    print(f"{script}: written; shells that start from now on use it")


for _flag in ("--install-completion", "--version", "--help"):
    app[_flag].group = app.group_parameters
for _key, (_name, _help) in enumerate(COMMANDS.items()):
    # Imported when it is used: Drake, SciPy and Matplotlib take a second.
    app.command(f"cpid_drake.commands.{_name}_command:{_name}", help=_help, sort_key=_key)


def _run(arguments: list[str]) -> int:
    """Run a command, and return its exit code."""
    _, [_, *commands], _ = app.parse_commands(arguments)  # imports them
    for command in commands:
        if command.default_command is not None:
            command.help = None  # its docstring says more than the list of commands
    is_complete = bool(commands) and commands[-1].default_command is not None
    logging.getLogger("drake").setLevel(logging.WARNING)  # Drake sets it when it is imported
    run, bound, _ = app.parse_args(arguments)
    return run(*bound.args, **bound.kwargs) or (0 if is_complete else 2)


def main() -> None:
    """Run `cpid` and exit with a code of `EXIT_CODES`; an error is one line on stderr."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # perhaps of a terminal that shows no σ
            stream.reconfigure(errors="backslashreplace")
    try:
        if codecs.lookup(locale.getpreferredencoding(False)).name == "ascii":
            raise InputError("Drake cannot read its files in an ASCII locale; set PYTHONUTF8=1")
        code = _run(sys.argv[1:])
        sys.stdout.flush()  # a full disk is noticed here
    except UnusedCliTokensError as error:
        code = _fail(f"not expected: {' '.join(error.unused_tokens or ())}")
    except (InputError, CycloptsError) as error:
        code = _fail(str(error))
    except (BrokenPipeError, SystemExit):  # the latter is how Rich ends
        code = 141
        _leave_output()
    except OSError as error:
        if not error.filename:  # standard output
            _leave_output()
        code = _fail(f"{error.filename or 'standard output'}: {error.strerror or error}")
    except KeyboardInterrupt:
        code = 130
        print("cpid: interrupted", file=sys.stderr)
    sys.exit(code)


def _leave_output() -> None:
    """Write the rest of standard output nowhere; the interpreter would fail again to write it."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _fail(message: str) -> int:
    print(f"cpid: error: {' '.join(message.split())}", file=sys.stderr)
    return 2

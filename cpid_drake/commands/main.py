"""The `cpid` command: its end, also after an interrupt."""

import sys

INTERRUPTED = 130


def main() -> None:
    """Run `cpid` and exit; an error or Ctrl-C causes one line on stderr."""
    try:
        from cpid_drake.commands.app import run

        code = run()
    except KeyboardInterrupt:
        code = INTERRUPTED
    if code == INTERRUPTED:  # also what Typer makes of an interrupt
        print("cpid: interrupted", file=sys.stderr)
    sys.exit(code)

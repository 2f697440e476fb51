"""Commands are run in the tests' own process: a start of Python for each would take far longer."""

import sys

import pytest

from cpid_drake.commands.main import main


@pytest.fixture
def run_cpid(monkeypatch, capsys):
    """Return a function that runs `cpid`: (code, stdout, stderr)."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["cpid", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        return ended.value.code, *capsys.readouterr()

    return run

"""The benchmark runs, and both of its routes end in the same estimate. No times are asserted."""

import json
import subprocess
import sys
from pathlib import Path

import pytest


def test_both_routes_agree_and_the_report_is_complete():
    pytest.importorskip("pinocchio", reason="the reference route needs the package 'pin'")
    script = Path(__file__).with_name("identifier_update.py")
    command = [sys.executable, str(script), "--blocks", "1", "--calls", "2"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    report = json.loads(result.stdout)
    assert {"update_over_pinocchio", "solve_over_pinocchio"} < set(report)
    assert all(value > 0 for value in report.values())

"""The Diagram of README.md is diagrams/identify.py, and it identifies."""

import re
import runpy

import numpy as np
from processes import ROOT


def test_the_diagram_of_the_readme_is_the_script_and_identifies_the_target(capsys):
    """Each parameter within 4 σ, and σ as small as the README says."""
    script = ROOT / "diagrams/identify.py"
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.S)
    [diagram] = [each for each in blocks if "DiagramBuilder()" in each]
    assert script.read_text().endswith(diagram)
    assert len(script.read_text().splitlines()) <= 100
    names = runpy.run_path(str(script))
    found, truth = names["found"], names["tank"].to_vector()
    assert (np.abs(found.parameters - truth) < 4 * names["sigma"]).all()
    assert names["sigma"][0] < 0.01
    log = names["state_log"].FindLog(names["root_context"])
    assert log.sample_times()[-1] == 10.0
    assert "determine 10 of 10" in capsys.readouterr().out

"""The Diagram of README.md identifies: it is run as it stands."""

import re

import numpy as np
from processes import ROOT


def test_the_diagram_of_the_readme_identifies_the_target(capsys):
    text = (ROOT / "README.md").read_text()
    blocks = re.findall(r"```python\n(.*?)```", text, re.S)
    [diagram] = [each for each in blocks if "DiagramBuilder()" in each]
    names = {}
    exec(compile(diagram, "README.md", "exec"), names)
    np.testing.assert_allclose(names["found"].parameters, names["target"].to_vector(), atol=1e-3)
    assert capsys.readouterr().out.startswith("m    60.0000  true  60.0000")

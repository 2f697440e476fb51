"""The dynamics are plain NumPy, and paths are found without Drake: importing either is fast."""

import subprocess
import sys

PROGRAM = """
import pkgutil, sys
import cpid_drake.dynamics, cpid_drake.files.resources
for module in pkgutil.iter_modules(cpid_drake.dynamics.__path__, "cpid_drake.dynamics."):
    __import__(module.name)
try:
    cpid_drake.files.resources.resolve_model("nowhere.urdf")
except cpid_drake.files.resources.InputError as error:
    assert "no such file" in str(error)
assert cpid_drake.files.resources.resolve_model("package://cpid_drake_models/scenarios/paper.yaml")
print([name for name in sys.modules if name.startswith("pydrake")])
"""


def test_neither_dynamics_nor_resources_import_drake():
    run = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True)
    assert run.stdout == "[]\n", run.stderr

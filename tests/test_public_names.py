"""The public names: each is there, and none loads what another one needs."""

import ast
import importlib.metadata
import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest
from processes import ROOT

import cpid_drake


def modules_after(statement: str) -> set[str]:
    """Return the modules that a new interpreter holds after a statement."""
    code = f"import sys; {statement}; print(*sys.modules)"
    return set(subprocess.check_output([sys.executable, "-c", code], text=True).split())


def test_every_public_name_is_there():
    assert "identify" in cpid_drake.__all__
    assert set(cpid_drake.__all__) <= set(dir(cpid_drake))
    for name in cpid_drake.__all__:
        assert getattr(cpid_drake, name) is not None, name


def test_other_names_are_not():
    with pytest.raises(AttributeError, match="Identify"):
        _ = cpid_drake.Identify


def test_the_path_is_the_first_argument_of_all_that_write_or_read_a_file():
    found = {name: getattr(cpid_drake, name) for name in cpid_drake.__all__}
    for name, each in found.items():
        arguments = [*inspect.signature(each).parameters] if inspect.isroutine(each) else []
        assert "path" not in arguments[1:], name
    assert {"write_log", "write_result", "write_report", "export_target"} <= found.keys()


def test_no_signature_shows_an_object_s_address():
    for name in cpid_drake.__all__:
        each = getattr(cpid_drake, name)
        if callable(each):
            for parameter in inspect.signature(each).parameters.values():
                assert " at 0x" not in inspect.formatannotation(parameter.annotation), name


def test_the_package_itself_loads_nothing_heavy():
    assert not modules_after("import cpid_drake") & {"numpy", "scipy", "pydrake", "plotly"}


def test_the_version_is_that_of_the_installed_package():
    assert cpid_drake.__version__ == importlib.metadata.version("cpid-drake")


def test_a_result_is_read_without_what_draws_it():
    assert not modules_after("from cpid_drake import read_result") & {"pydrake", "plotly"}


def test_a_name_loads_its_own_module():
    modules = modules_after("from cpid_drake import read_log")
    assert "numpy" in modules
    assert not modules & {"pydrake", "plotly"}


def test_the_stub_has_the_types_of_the_public_names():
    """Each from the module in which it is."""
    for node in ast.parse((Path(cpid_drake.__file__).parent / "__init__.pyi").read_text()).body:
        if isinstance(node, ast.ImportFrom):
            for each in node.names:
                module = importlib.import_module(f"cpid_drake.{node.module}")
                assert getattr(cpid_drake, each.name) is getattr(module, each.name)
        elif isinstance(node, ast.Assign):
            names = [*ast.literal_eval(node.value), "__version__"]
            assert set(cpid_drake.__all__) <= set(names)


SCRIPTS = sorted((ROOT / "diagrams").rglob("*.py"))


def private_imports(script: Path) -> list[str]:
    """Return the private names of the package that a script imports."""
    names = []
    for node in ast.walk(ast.parse(script.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("cpid_drake"):
            names += [*node.module.split("."), *(alias.name for alias in node.names)]
    return [name for name in names if name.startswith("_")]


def test_the_diagrams_and_studies_use_no_private_names():
    assert len(SCRIPTS) > 10
    private = {str(script.relative_to(ROOT)): private_imports(script) for script in SCRIPTS}
    assert {script: names for script, names in private.items() if names} == {}


def test_the_package_knows_nothing_of_the_studies():
    """Neither their modules nor their folder: the wheel does not have them."""
    for file in Path(cpid_drake.__file__).parent.rglob("*.py"):
        text = file.read_text()
        assert not re.search(r"^\s*(?:from|import) (?:paper|techniques)\b", text, re.M), file

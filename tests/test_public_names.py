"""The public names: each is there, and none loads what another one needs."""

import ast
import importlib.metadata
import inspect
import pkgutil
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
    assert not modules_after("import cpid_drake") & {"numpy", "scipy", "pydrake", "matplotlib"}


def test_the_version_is_that_of_the_installed_package():
    assert cpid_drake.__version__ == importlib.metadata.version("cpid-drake")


def test_a_result_is_read_without_what_draws_it():
    assert not modules_after("from cpid_drake import read_result") & {"pydrake", "matplotlib"}


def test_a_name_loads_its_own_module():
    modules = modules_after("from cpid_drake import read_log")
    assert "numpy" in modules
    assert not modules & {"pydrake", "matplotlib"}


def rooms() -> dict[str, set[str]]:
    """Return the public names of each folder of the package that lists some."""
    files = Path(cpid_drake.__file__).parent.glob("*/__init__.pyi")
    return {file.parent.name: {each.asname or each.name for each in listed(file)} for file in files}


def listed(file: Path) -> list[ast.alias]:
    nodes = ast.walk(ast.parse(file.read_text()))
    return [each for node in nodes if isinstance(node, ast.ImportFrom) for each in node.names]


def test_every_public_name_of_a_folder_is_there_and_is_no_module_of_it():
    found = rooms()
    assert {"dynamics", "simulation", "report"} <= found.keys()
    for room, names in found.items():
        folder = importlib.import_module(f"cpid_drake.{room}")
        modules = {each.name for each in pkgutil.iter_modules(folder.__path__)}
        assert not names & modules, room
        for name in names:
            assert getattr(folder, name) is not None, (room, name)


def private_names(text: str) -> list[str]:
    """Return what a script uses of the package and no list of public names has."""
    tree, known, own, found = ast.parse(text), rooms(), set(cpid_drake.__all__), []
    places: dict[str, tuple[str, set[str]]] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for each in node.names:
                if each.name == "cpid_drake":
                    places[each.asname or each.name] = ("cpid_drake", own | known.keys())
                elif each.name.startswith("cpid_drake."):
                    found.append(each.name)
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("cpid_drake"):
            room = node.module.partition(".")[2]
            public = known.get(room, set()) if room else own | known.keys()
            found += [f"{node.module}.{n.name}" for n in node.names if n.name not in public]
            for each in node.names:
                if not room and each.name in known:
                    places[each.asname or each.name] = (each.name, known[each.name])
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            place, public = places.get(node.value.id, ("", None))
            if public is not None and node.attr not in public:
                found.append(f"{place}.{node.attr}")
    return found


SCRIPTS = sorted((ROOT / "diagrams").rglob("*.py"))


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_the_diagrams_and_studies_use_public_names_only(script):
    assert not private_names(script.read_text())


def test_the_package_knows_nothing_of_the_studies():
    """Neither their modules nor their folder: the wheel does not have them."""
    for file in Path(cpid_drake.__file__).parent.rglob("*.py"):
        text = file.read_text()
        assert not re.search(r"^\s*(?:from|import) (?:paper|techniques)\b", text, re.M), file

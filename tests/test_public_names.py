"""The public names: each is there, and none loads what another one needs."""

import importlib.metadata
import subprocess
import sys

import pytest

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

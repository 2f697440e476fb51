"""The API reference notices what does not exist."""

import importlib.util
from pathlib import Path

import pdoc.doc
import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def build():
    spec = importlib.util.spec_from_file_location("docs_build", ROOT / ".ci/docs.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def index(build):
    names = ("cpid_drake.dynamics.rows", "cpid_drake.errors")
    return build.Index({name: pdoc.doc.Module.from_name(name) for name in names})


MODULE = '''"""Uses `%s`."""

def weigh(scale, unit="kg"):
    """Return what `scale` shows, in `unit`."""
    return scale.read_out(unit)
'''


@pytest.mark.parametrize(
    "name",
    [
        "rows.row_family",
        "cpid_drake.dynamics.rows.RowFamily.rows()",
        "InputError",
        "weigh",
        "scale",
        "scale.read_out(unit)",
        "kg",
        "numpy.linalg.norm",
        "Simulator.AdvanceTo",
        "p_CTcm_C",
        "run.json",
    ],
)
def test_a_name_that_exists_is_a_good_reference(build, index, tmp_path, name):
    path = tmp_path / "module.py"
    path.write_text(MODULE % name)
    assert build.broken_in_module(path, index) == []


@pytest.mark.parametrize(
    "name",
    ["rows.eq19_rows", "cpid_drake.row.row_family", "InputErrors", "weigh_all", "scale.tare()"]
    + ["numpy.linalg.norms", "Simulator.Advance", "RowFamily.colour"],
)
def test_a_name_that_does_not_exist_is_named_with_its_line(build, index, tmp_path, name):
    path = tmp_path / "module.py"
    path.write_text("# A comment.\n" + MODULE % name)
    assert build.broken_in_module(path, index) == [f"{path}:2: `{name.removesuffix('()')}`"]


def test_a_page_names_its_broken_links_tests_and_names(build, index, tmp_path):
    page = tmp_path / "README.md"
    (tmp_path / "picture.png").touch()
    page.write_text(
        "![good](picture.png) [bad](gone.md#part) <img src='x'> [far](https://example.org/x)\n"
        "`tests/test_docs.py` `tests/gone.py`\n"
        f"`tests/test_docs.py::{GOOD}` `tests/test_docs.py::test_nothing` `tests/gone.py::{GOOD}`\n"
        f"`{GOOD}` `test_of_nothing`\n"
        "`rows.inertia_operator` `rows.eq19_rows` `anything`\n"
    )
    gone = [
        "gone.md",
        "`tests/gone.py`",
        "`tests/test_docs.py::test_nothing`",
        f"`tests/gone.py::{GOOD}`",
        "`test_of_nothing`",
        "`rows.eq19_rows`",
    ]
    assert build.broken_in_page(page, index) == [f"{page}: {what}" for what in gone]


GOOD = "test_a_name_that_exists_is_a_good_reference"

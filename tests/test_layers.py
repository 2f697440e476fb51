"""The folders of the package import in one direction: that of the map in docs/how-to/add.md."""

import ast
import re

from processes import ROOT

PACKAGE = ROOT / "cpid_drake"
MAP = (ROOT / "docs/how-to/add.md").read_text()
FOLDERS = [
    name for row in re.findall(r"^\| (`.*?) \|", MAP, re.M) for name in re.findall(r"`(\w+)`", row)
]
"""The folders and modules of the map, from above to below."""


def imported(folder: str) -> set[str]:
    """Return the folders and modules of the package that the code of one imports."""
    files = (PACKAGE / folder).rglob("*.py") if (PACKAGE / folder).is_dir() else []
    found = set()
    for file in [*files, *PACKAGE.glob(f"{folder}.py")]:
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module == "cpid_drake":
                found |= {each.name for each in node.names if each.name in FOLDERS}
            elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("cpid_drake."):
                found.add((node.module or "").split(".")[1])
    return found - {folder}


def test_the_map_has_every_folder():
    there = {path.stem for path in PACKAGE.iterdir() if not path.name.startswith("__")}
    assert set(FOLDERS) == there - {"README", "py"}


def test_a_folder_imports_only_from_those_below_it():
    upward = {
        folder: imported(folder) - set(FOLDERS[position + 1 :])
        for position, folder in enumerate(FOLDERS)
    }
    assert {folder: names for folder, names in upward.items() if names} == {}

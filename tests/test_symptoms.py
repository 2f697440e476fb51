"""The page of symptoms names every check that an identification can fail."""

import ast
import importlib
import re

from processes import ROOT

PAGE = (ROOT / "docs/how-to/symptoms.md").read_text(encoding="utf-8")


def check_names() -> set[str]:
    """Return the names of all checks of the package; of a name with a sensor, the part before."""
    names = set()
    for path in (ROOT / "cpid_drake").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and ast.unparse(node.func) in ("Check", "Check.of"):
                names.add(value_of(node.args[0], path))
    return names


def value_of(node: ast.expr, path) -> str:
    if isinstance(node, ast.JoinedStr):
        return f"{node.values[0].value.strip()} …"
    if isinstance(node, ast.Name):
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        return getattr(importlib.import_module(module), node.id)
    return ast.literal_eval(node)


def test_every_check_is_on_the_page_of_symptoms_and_every_name_there_is_a_check():
    table = PAGE.split("| Check |")[1].split("\n\n")[0]
    assert set(re.findall(r"^\| `(.+?)`", table, re.M)) == check_names()

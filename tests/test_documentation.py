"""Each name in backticks of a docstring or a page exists; Sphinx checks links and signatures."""

import ast
import functools
import importlib
import inspect
import pkgutil
import re
from collections.abc import Callable, Iterable
from pathlib import Path

from processes import ROOT

import cpid_drake

PAGES = sorted(
    path
    for pattern in (
        *("README.md", "cpid_drake/README.md", "diagrams/README.md", "models/**/README.md"),
        "docs/**/*.md",
    )
    for path in ROOT.glob(pattern)
)
MODULES = sorted((ROOT / "cpid_drake").rglob("*.py"))
DRAKE = (
    *("common.schema", "geometry", "multibody.parsing", "multibody.plant"),
    *("systems.analysis", "systems.primitives"),
)
NAME = r"[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*"
REFERENCE = re.compile(rf"(?<!`)`({NAME})(?:\([^`]*\))?`(?!`)")
TEST = re.compile(r"`(?:(tests/[\w/.]+\.py)(?:::)?)?(test_\w+)?`")
NOT_A_NAME = re.compile(
    r".*\.(csv|db3|html|json|mcap|md|parquet|pyi?|toml|urdf|xml|yaml)$"  # a file
    r"|[a-z]+\d*$"  # a plain word: a column, a key of a file, a port, an option
    r"|[A-Za-z]+\d?_[A-Z]\w*$"  # a quantity in monogram notation: p_CTcm_C
)


@functools.cache
def known_names() -> tuple[set[str], set[str]]:
    """Return all ends of the package's dotted names, and the short names of its modules."""
    names, short = set(), set()
    for found in pkgutil.walk_packages(cpid_drake.__path__, "cpid_drake."):
        if found.name.endswith("__main__"):
            continue
        module = importlib.import_module(found.name)
        members = {found.name}
        short.add(found.name.rpartition(".")[2])
        for name, value in [*vars(module).items(), *((n, None) for n in exported(module))]:
            members.add(f"{found.name}.{name}")
            if inspect.isclass(value) and value.__module__.startswith("cpid_drake"):
                fields = {field for base in value.__mro__ for field in vars(base)}
                for base in value.__mro__:
                    fields |= getattr(base, "__annotations__", {}).keys()
                    fields |= own_attributes(base)
                members |= {f"{found.name}.{name}.{field}" for field in fields}
        for full in members:
            parts = full.split(".")
            names |= {".".join(parts[i:]) for i in range(len(parts))}
    names |= {f"cpid_drake.{name}" for name in cpid_drake.__all__}
    return names, short


def exported(module) -> list[str]:
    """Return the names that a package loads when they are first used."""
    return list(getattr(module, "__all__", ()))


@functools.cache
def own_attributes(owner: type) -> frozenset[str]:
    """Return the attributes that the methods of a class of the package set."""
    if not owner.__module__.startswith("cpid_drake"):
        return frozenset()
    return frozenset(re.findall(r"\bself\.(\w+)(?:, self\.\w+)* =", inspect.getsource(owner)))


def exists(name: str, local: set[str] = frozenset()) -> bool:
    """Return whether a name is known to the package, to one module's code, or importable."""
    names, modules = known_names()
    parts = name.split(".")
    if name in names or NOT_A_NAME.match(name):
        return True
    if parts[0] in modules:
        return False
    return local.issuperset(parts) or is_importable(name)


def is_importable(name: str) -> bool:
    """Return whether other packages have a name: `numpy.cross`, or `Simulator` of Drake."""
    for full_name in (name, *(f"pydrake.{module}.{name}" for module in DRAKE), f"builtins.{name}"):
        try:
            if pkgutil.resolve_name(full_name):
                return True
        except (ImportError, AttributeError):
            continue
    return False


def docstrings(tree: ast.AST) -> dict[int, ast.Constant]:
    """Return the docstrings of all kinds, which are strings as statements, by their `id`."""
    nodes = (node.value for node in ast.walk(tree) if isinstance(node, ast.Expr))
    return {id(n): n for n in nodes if isinstance(n, ast.Constant) and isinstance(n.value, str)}


def local_names(tree: ast.AST) -> set[str]:
    """Return the identifiers of a module's code, and the words in its strings: keys, ports."""
    documentation, names = docstrings(tree), {"self"}
    for node in ast.walk(tree):
        names |= {getattr(node, field, None) for field in ("id", "attr", "arg", "name", "asname")}
        if isinstance(node, ast.Constant) and id(node) not in documentation:
            names.update(re.findall(r"\w+", str(node.value)))
    return names


def broken_in_module(text: str) -> list[str]:
    """Return the names in backticks of a module's docstrings that do not exist."""
    tree = ast.parse(text)
    local = local_names(tree)
    references = (m[1] for n in docstrings(tree).values() for m in REFERENCE.finditer(n.value))
    return [name for name in references if not exists(name, local)]


def has_test(file: str | None, test: str | None) -> bool:
    """Return whether a file below `tests` exists and defines a test; default: any file, no test."""
    files = [ROOT / file] if file else (ROOT / "tests").rglob("test_*.py")
    texts = (path.read_text(encoding="utf-8") for path in files if path.exists())
    return any(test is None or f"def {test}(" in text for text in texts)


def broken_in_page(text: str) -> list[str]:
    """Return the tests and dotted names in backticks of a page that do not exist."""
    names = [m[1] for m in REFERENCE.finditer(text) if "." in m[1]]
    broken = [m[0] for m in TEST.finditer(text) if m[0] != "``" and not has_test(m[1], m[2])]
    return broken + [name for name in names if not exists(name)]


def broken(paths: Iterable[Path], names: Callable[[str], list[str]]) -> dict[str, list[str]]:
    """Return the names that do not exist, by the file in which they are."""
    by_file = {str(p.relative_to(ROOT)): names(p.read_text(encoding="utf-8")) for p in paths}
    return {file: missing for file, missing in by_file.items() if missing}


def test_the_names_in_the_docstrings_of_modules_exist():
    assert len(MODULES) > 100
    assert broken(MODULES, broken_in_module) == {}


def test_the_names_of_pages_exist():
    assert len(PAGES) > 20
    assert broken(PAGES, broken_in_page) == {}

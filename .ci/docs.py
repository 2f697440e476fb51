"""Build the API reference: `python .ci/docs.py FOLDER`. Exits with 1 if a reference is broken.

pdoc makes the pages from the docstrings. The first page is `cpid_drake/README.md`, its formulas as
MathML; no page loads anything from a network. Two things are checked that pdoc does not check:
each name in backticks of a docstring or a README exists, and each link of a README has its file.
"""

import ast
import importlib
import pkgutil
import re
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from types import GenericAlias, SimpleNamespace

import markupsafe
import numpy.typing
import pdoc.doc
import pdoc.extract
import pdoc.render
import pdoc.render_helpers

ROOT = Path(__file__).parents[1]
PAGES = (
    "README.md",
    "cpid_drake/README.md",
    "diagrams/README.md",
    "docs/*.md",
    "models/**/README.md",
)
DRAKE = (
    *("common.schema", "geometry", "multibody.parsing", "multibody.plant"),
    *("systems.analysis", "systems.primitives"),
)
NAME = r"[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*"
REFERENCE = re.compile(rf"(?<!`)`({NAME})(?:\([^`]*\))?`(?!`)")
LINK = re.compile(r"(?<!`)\[[^]]*]\(([^)#\s]+)[^)]*\)|(?:src|href)=\"([^\"#]+)")
TEST = re.compile(r"`(?:(tests/[\w/.]+\.py)(?:::)?)?(test_\w+)?`")
NOT_A_NAME = re.compile(
    r".*\.(csv|db3|html|json|mcap|md|npz|parquet|py|toml|urdf|xml|yaml)$"  # a file
    r"|[a-z]+\d*$"  # a plain word: a column, a key of a file, a port, an option
    r"|[A-Za-z]+\d?_[A-Z]\w*$"  # a quantity in monogram notation: p_CTcm_C
)


class Index:
    """The names of the package, each found by any end of its dotted name."""

    def __init__(self, modules: dict[str, pdoc.doc.Module]):
        self.short_module_names = {name.rpartition(".")[2] for name in modules}
        self._docs: dict[str, pdoc.doc.Doc] = {}
        for module in modules.values():
            for doc in (module, *_members_of(module)):
                defined_here = doc.fullname == ".".join(filter(None, doc.taken_from))
                parts = doc.fullname.split(".")
                for ending in (".".join(parts[i:]) for i in range(len(parts))):
                    if defined_here or ending not in self._docs:
                        self._docs[ending] = doc

    def find(self, name: str) -> pdoc.doc.Doc | None:
        """Return what a name of the package stands for, or None."""
        return self._docs.get(name)

    def exists(self, name: str, local: set[str] = frozenset()) -> bool:
        """Return whether a name is known to the package, to one module's code, or importable.

        A dotted name that begins with a module of the package must be in that module.
        """
        parts = name.split(".")
        if self.find(name) or NOT_A_NAME.match(name):
            return True
        if parts[0] in self.short_module_names:
            return False
        return local.issuperset(parts) or _is_importable(name)


def _members_of(doc: pdoc.doc.Namespace) -> Iterator[pdoc.doc.Doc]:
    """Yield what a module or class holds, classes with their own members."""
    for member in doc.members.values():
        yield member
        if isinstance(member, pdoc.doc.Class):
            yield from _members_of(member)


def _is_importable(name: str) -> bool:
    """Return whether other packages have a name: `numpy.cross`, or `Simulator` of Drake."""
    for full_name in (name, *(f"pydrake.{module}.{name}" for module in DRAKE), f"builtins.{name}"):
        try:
            if pkgutil.resolve_name(full_name):
                return True
        except (ImportError, AttributeError):
            continue
    return False


def _documentation(tree: ast.AST) -> dict[int, ast.Constant]:
    """Return the docstrings of all kinds, which are strings as statements, by their `id`."""
    nodes = (node.value for node in ast.walk(tree) if isinstance(node, ast.Expr))
    return {id(n): n for n in nodes if isinstance(n, ast.Constant) and isinstance(n.value, str)}


def _local_names(tree: ast.AST) -> set[str]:
    """Return the identifiers of a module's code, and the words in its strings: keys, ports."""
    documentation, names = _documentation(tree), {"self"}
    for node in ast.walk(tree):
        names |= {getattr(node, field, None) for field in ("id", "attr", "arg", "name", "asname")}
        if isinstance(node, ast.Constant) and id(node) not in documentation:
            names.update(re.findall(r"\w+", str(node.value)))
    return names


def broken_in_module(path: Path, index: Index) -> list[str]:
    """Return a line for each name in backticks of a module's docstrings that does not exist."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    local = _local_names(tree)
    return [
        f"{path}:{node.lineno + node.value.count(chr(10), 0, match.start())}: `{match[1]}`"
        for node in _documentation(tree).values()
        for match in REFERENCE.finditer(node.value)
        if not index.exists(match[1], local)
    ]


def _test_exists(file: str | None, test: str | None) -> bool:
    """Return whether a file below `tests` exists and defines a test; default: any file, no test."""
    files = [ROOT / file] if file else (ROOT / "tests").rglob("test_*.py")
    texts = (path.read_text(encoding="utf-8") for path in files if path.exists())
    return any(test is None or f"def {test}(" in text for text in texts)


def broken_in_page(path: Path, index: Index) -> list[str]:
    """Return a line for each link, test and dotted name of a page that does not exist."""
    text = path.read_text(encoding="utf-8")
    links = [m[1] or m[2] for m in LINK.finditer(text)]
    names = [m[1] for m in REFERENCE.finditer(text) if "." in m[1]]
    broken = [link for link in links if "://" not in link and not (path.parent / link).exists()]
    broken += [m[0] for m in TEST.finditer(text) if not _test_exists(m[1], m[2])]
    broken += [f"`{name}`" for name in names if not index.exists(name)]
    return [f"{path}: {what}" for what in broken]


def _linker(index: Index, modules: dict[str, pdoc.doc.Module]):
    """Return pdoc's filter that links names in pages, extended to names such as `rows.linear_rows`.

    pdoc links names of the same module and those with the package's name in front.
    """

    @pdoc.render_helpers.pass_context
    def linkify(context, code: str, namespace: str = "", shorten: bool = True):
        def link(match: re.Match) -> str:
            doc = index.find(match[1])
            if doc is None or not doc.docstring or doc.name.startswith("_"):
                return match[0]
            target = doc.modulename if doc.kind != "module" else doc.fullname
            page = pdoc.render_helpers.relative_link(context["module"].modulename, target)
            return f'<code><a href="{page}#{doc.qualname}">{match[0][6:-7]}</a></code>'

        linked = pdoc.render_helpers.linkify(context, code, namespace, shorten)
        return markupsafe.Markup(re.sub(rf"<code>({NAME})(?:\(\))?</code>", link, linked))

    return linkify


def _load() -> dict[str, pdoc.doc.Module]:
    """Return the package's modules by name, with the README after the package's docstring."""
    for name in ("ArrayLike", "NDArray"):  # signatures show these names, not what they stand for
        generic = {"__module__": "numpy.typing", "__class_getitem__": classmethod(GenericAlias)}
        setattr(numpy.typing, name, type(name, (), generic))
    # The type of dataclasses is known to type checkers only.
    sys.modules.setdefault("_typeshed", SimpleNamespace(DataclassInstance=object))
    package = importlib.import_module("cpid_drake")
    for name in package.__all__:  # pdoc shows names that are already imported
        setattr(package, name, getattr(package, name))
    folders = [m.name for m in pkgutil.iter_modules(package.__path__) if m.name != "__main__"]
    package.__all__ = [*package.__all__, *folders]  # pdoc leaves out what is not in `__all__`
    readme = (ROOT / "cpid_drake/README.md").read_text(encoding="utf-8")
    package.__doc__ = f"{package.__doc__}\n{readme.partition(chr(10))[2]}"  # without its title
    return {n: pdoc.doc.Module.from_name(n) for n in pdoc.extract.walk_specs([package.__name__])}


def main(folder: Path) -> int:
    """Write the pages to a folder, print the broken references, and return the exit code."""
    with warnings.catch_warnings(record=True) as caught:
        modules = _load()
        index = Index(modules)
        pdoc.render.configure(docformat="google")
        pdoc.render.env.filters["linkify"] = _linker(index, modules)
        pdoc.render_helpers.markdown_extensions["latex"] = None
        for name, module in modules.items():
            path = folder / f"{name.replace('.', '/')}.html"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(pdoc.render.html_module(module, modules), encoding="utf-8")
        (folder / "index.html").write_text(pdoc.render.html_index(modules), encoding="utf-8")
        (folder / "search.js").write_text(pdoc.render.search_index(modules), encoding="utf-8")

    pages = sorted(path for pattern in PAGES for path in ROOT.glob(pattern))
    broken = [line for m in modules.values() for line in broken_in_module(m.source_file, index)]
    broken += [line for path in pages for line in broken_in_page(path, index)]
    for line in broken:
        print(f"{line} does not exist", file=sys.stderr)
    for warning in caught:
        print(warning.message, file=sys.stderr)
    return int(bool(broken or caught))


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))

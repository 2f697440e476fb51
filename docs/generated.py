"""Pages of the documentation that are made from the code: public names, keys of scenarios."""

import ast
import dataclasses
import inspect
import itertools
import json
import typing
from collections.abc import Iterator
from pathlib import Path

from cpid_drake import Scenario
from cpid_drake.commands.main import app

DOCS = Path(__file__).parent
ROOT = DOCS.parent
PACKAGE = ROOT / "cpid_drake"


def write_pages() -> None:
    """Write the pages into reference/api; autosummary writes that of each name beside them."""
    folder = DOCS / "reference/api"
    folder.mkdir(exist_ok=True)
    for name, lines in (
        ("index", names_page()),
        ("scenario-keys", keys_page()),
        ("cpid", cpid_page()),
    ):
        page, text = folder / f"{name}.rst", "\n".join(lines)
        if not page.exists() or page.read_text(encoding="utf-8") != text:
            page.write_text(text, encoding="utf-8")


def names_page() -> Iterator[str]:
    """Yield the lines of the page that lists all public names, from the stub."""
    yield from _heading("Public names", "=")
    yield from (".. autosummary::", "   :toctree: .", "")
    yield from (f"   cpid_drake.{name}" for name in public_names(PACKAGE / "__init__.pyi"))
    yield ""


def cpid_page() -> Iterator[str]:
    """Yield the lines of the page with all commands and their options, from their functions."""
    for name in app:
        if app[name].default_command is not None:
            app[name].help = None  # the docstring says more
    yield app.generate_docs("rst")


def keys_page() -> Iterator[str]:
    """Yield the lines of the page with all keys of a scenario, from its dataclasses."""
    yield from _heading("Keys of a scenario", "=")
    yield "The keys of the YAML file that ``cpid simulate`` reads, section by section."
    yield ""
    yield from _section("the file", Scenario)
    seen: set[type] = set()
    for path, kind in _sections(Scenario, ""):
        if kind not in seen:
            seen.add(kind)
            yield from _section(path, kind)


def _section(path: str, kind: type) -> Iterator[str]:
    """Yield a section's keys with their defaults, and its description."""
    name = kind.__name__
    tag = f" !{name}" if name.endswith("Motion") and name != "HalfCosineMotion" else ""
    yield from _heading(f"{path}{tag}", "-")
    yield from (".. list-table::", "   :header-rows: 1", "   :widths: 40 60", "")
    yield from ("   * - key", "     - default")
    for field in dataclasses.fields(kind):
        yield from (f"   * - ``{field.name}``", f"     - {_default(field)}")
    yield from ("", f".. autoclass:: {kind.__module__}.{name}()", "   :no-index:", "")


def _default(field: dataclasses.Field) -> str:
    """Return the default of a key, in words if it is a section."""
    missing = dataclasses.MISSING
    if field.default is missing and field.default_factory is missing:
        return "required"
    value = field.default if field.default is not missing else field.default_factory()
    if dataclasses.is_dataclass(value):
        return "that of each key"
    value = value.tolist() if hasattr(value, "tolist") else value
    return f"``{json.dumps(value)}``"


def _sections(kind: type, path: str) -> Iterator[tuple[str, type]]:
    """Yield the path and the dataclass of each section, those inside of it included."""
    hints = typing.get_type_hints(kind)
    for field in dataclasses.fields(kind):
        for each in dict.fromkeys(_dataclasses(hints[field.name])):
            yield f"{path}{field.name}", each
            yield from _sections(each, f"{path}{field.name}.")


def _dataclasses(hint: object) -> Iterator[type]:
    """Yield the dataclasses of a type."""
    if isinstance(hint, type) and dataclasses.is_dataclass(hint):
        yield hint
    for argument in typing.get_args(hint):
        yield from _dataclasses(argument)


def _heading(text: str, line: str) -> list[str]:
    return [text, len(text) * line, ""]


def public_names(stub: Path) -> list[str]:
    """Return the names that a stub of a package lists in `__all__`."""
    for node in ast.parse(stub.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return [name for name in ast.literal_eval(node.value) if not name.startswith("__")]
    return []


def comment_of(full_name: str) -> list[str]:
    """Return the lines of the string below the assignment of a public name that is no function."""
    module, _, name = full_name.rpartition(".")
    stub = ROOT / module.replace(".", "/") / "__init__.pyi"
    for node in ast.parse(stub.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom) and name in [each.name for each in node.names]:
            source = stub.parent / f"{node.module.replace('.', '/')}.py"
            body = ast.parse(source.read_text(encoding="utf-8")).body
            for this, following in itertools.pairwise(body):
                targets = getattr(this, "targets", [getattr(this, "target", None)])
                if name in {n.id for t in targets if t for n in ast.walk(t) if hasattr(n, "id")}:
                    comment = getattr(getattr(following, "value", None), "value", None)
                    return inspect.cleandoc(
                        comment if isinstance(comment, str) else ""
                    ).splitlines()
    return []

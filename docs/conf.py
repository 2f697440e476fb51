"""The documentation, by Sphinx: `make docs` builds it into out/docs, and fails at any warning.

The pages are Markdown (MyST). The READMEs of the folders are pages too. Tutorials are scripts in
Jupytext's percent format, which are executed; a claim that fails fails the build. Formulas are
MathML, and no page loads anything from a network.
"""

import contextlib
import os
import posixpath
import re
import sys
from pathlib import Path
from pkgutil import resolve_name

import yaml
from docutils import nodes
from latex2mathml.converter import convert
from sphinx import addnodes
from sphinx.ext.napoleon.docstring import GoogleDocstring
from sphinx.util.docutils import SphinxDirective
from sphinx.util.nodes import make_refnode

sys.path.insert(0, str(Path(__file__).parent))
from generated import DOCS, ROOT, comment_of, write_pages

project = "cpid_drake"
copyright = "cpid_drake maintainers"
html_title = project
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "sphinx.ext.napoleon"]
exclude_patterns = ["conf.py", "generated.py", "_templates"]
templates_path = ["_templates"]
html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["wide.css"]
html_math_renderer = "mathml"
html_copy_source = False
default_role = "py:obj"  # a docstring's names in backticks
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
python_use_unqualified_type_names = True
napoleon_use_ivar = True
myst_enable_extensions = ["dollarmath", "amsmath"]
myst_heading_anchors = 4
nb_custom_formats = {".py": ["jupytext.reads", {"fmt": "py:percent"}]}
nb_execution_mode = "force"
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_timeout = 120
nb_merge_streams = True
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

READMES = {
    "reference/mathematics": "cpid_drake/README.md",
    "reference/models": "models/README.md",
    "reference/log-formats": "models/telemetry/README.md",
    "reference/changes": "CHANGELOG.md",
    "how-to/diagrams": "diagrams/README.md",
    "how-to/develop": "CONTRIBUTING.md",
}
"""The pages whose text is a file outside of this folder."""


def replace_readme(app, page: str, source: list[str]) -> None:
    """Replace the stub of a README's page by the README, and let links lead to such pages."""
    place = posixpath.dirname(page)
    text, origin = source[0], posixpath.join("docs", place)
    if page in READMES:
        text = (ROOT / READMES[page]).read_text(encoding="utf-8")
        origin = posixpath.dirname(READMES[page])
    pages = {readme: f"docs/{name}.md" for name, readme in READMES.items()}

    def relative(match: re.Match) -> str:
        path, hash_sign, anchor = match[2].partition("#")
        if "://" in match[2] or not path:
            return match[0]
        full = posixpath.normpath(posixpath.join(origin, path))
        target = posixpath.relpath(pages.get(full, full), posixpath.join("docs", place))
        if full.endswith(".py") and not full.startswith("docs/"):
            return f"{{download}}`{match[1].replace('`', '')} <{target}>`"
        return f"[{match[1]}]({target}{hash_sign}{anchor})"

    if (DOCS / f"{page}.md").exists():
        source[0] = re.sub(r"\[((?:[^][]|\[[^]]*])*)]\(([^)\s]+)\)", relative, text)


def prepare_docstring(_app, what: str, name: str, _object, _options, lines: list[str]) -> None:
    """Mend what napoleon does not read: several names with one text, and constants."""
    if what == "data":
        lines[:] = comment_of(name)
    several = re.compile(r"( +)(\w+(?:, \w+)+):(.*)")
    for i in reversed(range(len(lines))):
        if match := several.fullmatch(lines[i]):
            indent, names, text = match.groups()
            rest = lines[i + 1 :]
            end = next((k for k, x in enumerate(rest) if not x.startswith(indent + " ")), len(rest))
            more = rest[:end]
            new = [new for each in names.split(", ") for new in (f"{indent}{each}:{text}", *more)]
            lines[i : i + 1 + len(more)] = new


def skip_member(_app, _what, _name, member, skip: bool, _options) -> bool:
    """Skip what a class inherits from Drake or Python."""
    function = getattr(member, "__func__", member)
    foreign = callable(function) and not str(getattr(function, "__module__", None)).startswith(
        "cpid_drake"
    )
    return skip or foreign


class PortsDirective(SphinxDirective):
    """Drake's `pydrake_system`: the ports of a system."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """Return a field list of the ports."""
        ports = yaml.safe_load("\n".join(self.content))
        fields = nodes.field_list()
        for key, title in (("input_ports", "Input ports"), ("output_ports", "Output ports")):
            text = ", ".join(f"``{port}``" for port in ports.get(key, ()))
            body = self.parse_inline(text)[0]
            field = nodes.field("", nodes.field_name(text=title))
            field += nodes.field_body("", nodes.paragraph("", "", *body))
            fields += field
        return [fields]


PLACES = (
    *("", "builtins.", "typing.", "numpy.", "numpy.typing.", "collections.abc."),
    *("plotly.graph_objects.", "pydrake.multibody.tree."),
)


def exists(name: str) -> bool:
    """Return whether a type or a number of a signature stands for something."""
    if re.fullmatch(r"[-+.e\d]+", name):
        return True
    name = name.lstrip("~").partition("[")[0].replace("types.Annotated", "typing.Annotated")
    for place in PLACES:
        with contextlib.suppress(ImportError, AttributeError, ValueError):
            resolve_name(place + name)
            return True
    return False


NAME = re.compile(r"[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*")


def link_names(app, doctree: nodes.document) -> None:
    """Make references of the names in backticks of a Markdown page."""
    page = app.env.current_document.docname
    for literal in (
        [] if page.startswith("reference/api/") else list(doctree.findall(nodes.literal))
    ):
        name = literal.astext().partition("(")[0]
        if NAME.fullmatch(name) and not literal.parent.get("refuri") and literal.children:
            options = {"refdomain": "py", "reftype": "obj", "reftarget": name, "refdoc": page}
            reference = addnodes.pending_xref("", literal.deepcopy(), **options)
            if any(c.isupper() for c in name) or "_" in name:
                literal.replace_self(reference)


def resolve(app, env, node, content):
    """Return a link, or the plain text of a name that is no page, if it exists; else None.

    None is a warning. tests/test_documentation.py checks the names in backticks, also those of
    private docstrings, which are known by any end of their dotted name.
    """
    if node.get("refdomain") != "py":
        return None
    if node["reftype"] != "obj":
        return content if exists(node["reftarget"]) else None
    own, _, last = node["reftarget"].rpartition(".")
    objects = env.domains["py"].objects
    for owner in (own, ""):
        end = "." + ".".join(filter(None, (owner, last)))
        found = {
            (entry.docname, entry.node_id)
            for full, entry in objects.items()
            if f".{full}".endswith(end) and (owner or entry.objtype not in ("method", "attribute"))
        }
        if len(found) == 1:
            [(page, anchor)] = found
            return make_refnode(app.builder, node["refdoc"], page, anchor, content)
    return content


def visit_math(self, node) -> None:
    """Write a formula as MathML."""
    display = "block" if isinstance(node, nodes.math_block) else "inline"
    self.body.append(convert(node.astext(), display=display))
    raise nodes.SkipNode


def setup(app) -> None:
    """Connect what is above with Sphinx."""
    app.add_html_math_renderer("mathml", (visit_math, None), (visit_math, None))
    app.connect("config-inited", lambda _app, _config: write_pages())
    app.connect("source-read", replace_readme)
    app.connect("doctree-read", link_names)
    app.connect("missing-reference", resolve)
    app.connect("autodoc-process-docstring", prepare_docstring, priority=100)
    app.connect("autodoc-skip-member", skip_member)
    app.add_directive("pydrake_system", PortsDirective)
    # The text before the colon of a property's docstring is no type.
    GoogleDocstring._consume_inline_attribute = lambda self: (
        "",
        self._dedent(self._consume_to_end()),
    )

"""Pages have short sentences and cells of tables; pages and code use the field's words."""

import re
from collections.abc import Iterator

import pytest
from processes import ROOT

LONGEST_SENTENCE, LONGEST_CELL = 25, 15
"""In words with a letter; code, a formula and a link's address are one word or none."""

PAGES = sorted(
    path
    for pattern in (
        *("cpid_drake/README.md", "diagrams/README.md", "models/**/README.md"),
        *("docs/**/*.md", "docs/tutorials/*.py"),
    )
    for path in ROOT.glob(pattern)
)
REPLACED = re.compile(
    r"\bleans? on\b|\bleaning\b|\w*observab\w*|\b\w*feasib\w*\b(?! generalized)"
    r"|\bknown (?:bodies|spacecraft)\b|\bturn of the base\b|\bshift of the base\b",
    re.I,
)
"""For sensitivity, identifiable, physically consistent, spacecraft model, rotation, translation."""

FENCE = re.compile(r"^( *)(```|~~~).*?^\1\2 *$|\$\$.*?\$\$", re.S | re.M)
LINK = re.compile(r"!?\[([^][]*(?:\[[^]]*\][^][]*)*)\]\([^)]*\)")
CODE = re.compile(r"`+[^`]+`+|\$[^$\n]+\$")
ITEM = re.compile(r"\n\s*\n|^ *(?:[-*]|\d+\.) +|^ *#.*$|^(?= *\|)", re.M)
END = re.compile(r"(?<=[.!?:])[\"”)*_]*\s+(?=[\"“(*_A-ZΑ-Ω0-9])")


def prose(text: str, suffix: str) -> str:
    """Return the words of a page: of a tutorial, its Markdown; without code, formulas, links."""
    if suffix == ".py":
        cells = re.findall(r"^# %% \[markdown\]\n((?:#.*\n)*)", text, re.M)
        text = "\n\n".join(re.sub(r"^# ?", "", cell, flags=re.M) for cell in cells)
    return CODE.sub("Code", LINK.sub(r"\1", CODE.sub("Code", FENCE.sub("\n\n", text))))


def sentences(text: str) -> Iterator[str]:
    """Yield the sentences of prose, without tables."""
    for block in ITEM.split(text):
        if block and not block.lstrip().startswith("|"):
            yield from END.split(" ".join(block.split()))


def cells(text: str) -> Iterator[str]:
    """Yield the cells of the tables of prose."""
    for line in text.splitlines():
        if line.lstrip().startswith("|"):
            yield from line.strip().strip("|").split("|")


def length(text: str) -> int:
    """Return the number of words with a letter."""
    return sum(bool(re.search(r"[^\W\d_]", word)) for word in text.split())


@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_sentences_and_cells_are_short(path):
    text = prose(path.read_text(encoding="utf-8"), path.suffix)
    assert [each for each in sentences(text) if length(each) > LONGEST_SENTENCE] == []
    assert [each for each in cells(text) if length(each) > LONGEST_CELL] == []


@pytest.mark.parametrize(
    "path",
    [
        *PAGES,
        *sorted((ROOT / "cpid_drake").rglob("*.py")),
        *sorted((ROOT / "diagrams").rglob("*.py")),
    ],
    ids=lambda path: str(path.relative_to(ROOT)),
)
def test_words_that_the_field_has_others_for_are_not_used(path):
    assert REPLACED.findall(" ".join(path.read_text(encoding="utf-8").split())) == []

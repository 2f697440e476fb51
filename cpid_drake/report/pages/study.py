"""The page of a study: its sections, how it was made, and files with its numbers."""

import shlex
from collections.abc import Mapping, Sequence

from cpid_drake.report.page import Report, Section
from cpid_drake.report.sections.data import written_by


def study_report(
    title: str,
    subtitle: str,
    sections: Sequence[Section],
    facts: Sequence[tuple[str, str]],
    words: Sequence[str],
    files: Mapping[str, str],
) -> Report:
    """Return a page that ends with facts, the software's versions, and the command `words`."""
    provenance = Section("Provenance", facts=[*facts, written_by()], command=shlex.join(words))
    return Report(title, subtitle, [*sections, provenance], files=files)

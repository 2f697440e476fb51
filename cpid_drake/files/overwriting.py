"""The rule that protects files that exist already; it is the same for all outputs.

No output is also an input or another output of the same command, whatever its name. A file that
exists is replaced only with `--force`.
"""

import os
import tempfile
from collections.abc import Iterable
from pathlib import Path

from cpid_drake.files.drafts import write_errors
from cpid_drake.files.errors import InputError

_DRAWN = (".html", ".png", ".svg")
"""Endings of files in a folder that are no inputs: pages and pictures of what the folder holds."""


def check_outputs(
    outputs: Iterable[tuple[str, Path | None]],
    inputs: Iterable[str | Path | None] = (),
    *,
    force: bool = False,
) -> None:
    """Before the work begins, refuse outputs that cannot be written or would destroy a file.

    Args:
        outputs: the files that the command writes, each with the option that names it; None for an
            option that is not given, as in `inputs`.
        inputs: the files and folders that the command reads; those that do not exist are ignored.
            All files in a folder are inputs, except pages and pictures.
        force: whether files that exist may be replaced. Inputs are protected in any case.

    Raises:
        InputError: see the rule above; also if a path is that of a folder or of a device, or if
            nothing can be written there.

    """
    originals: list[Path] = []
    for source in (Path(each) for each in inputs if each is not None):
        files = source.iterdir() if source.is_dir() else [source]
        originals += [each for each in files if each == source or each.suffix.lower() not in _DRAWN]
    before: list[Path] = []
    for option, path in ((option, path) for option, path in outputs if path is not None):
        where = f"{option} {path!s:.200}".strip()
        with write_errors(where):
            if not path.parent.is_dir():
                raise InputError(f"{where}: there is no folder {path.parent}")
            if path.exists() and not path.is_file():
                what = "a folder" if path.is_dir() else "a device or a pipe"
                raise InputError(f"{where}: is {what}; name a file")
            lost = [source for source in originals if _is_same(path, source)]
            if lost:
                raise InputError(
                    f"{where}: is the input {lost[0]}, which would be lost; give another name"
                )
            if any(_is_same(path, other) for other in before):
                raise InputError(f"{where}: two outputs cannot be the same file")
            if path.exists() and not force:
                raise InputError(
                    f"{where}: exists already; give another name, or replace it with --force"
                )
            _make_a_file(Path(os.path.realpath(path)).parent)
        before.append(path)


def check_folder(
    option: str,
    folder: Path | None,
    inputs: Iterable[str | Path | None] = (),
    *,
    names: Iterable[str] | None = None,
    force: bool = False,
) -> None:
    """Before the work begins, refuse a folder in which files of these names cannot be written.

    Without names, all files in the folder may be replaced. None for an option that is not given.

    Raises:
        InputError: the folder cannot be made or written in; or as for `check_outputs`.

    """
    if folder is None:
        return
    with write_errors(f"{option} {folder!s:.200}"):
        _make_a_file(next(each for each in (folder, *folder.absolute().parents) if each.exists()))
    if names is None:
        names = [each.name for each in folder.glob("*") if each.is_file()]
    if folder.exists():
        check_outputs([(option, folder / name) for name in names], inputs, force=force)


def _make_a_file(folder: Path) -> None:
    with tempfile.TemporaryFile(dir=folder):
        pass


def _is_same(first: Path, second: Path) -> bool:
    """Return whether two paths refer to the same file, also through links."""
    if first.exists() and second.exists():
        return first.samefile(second)
    return os.path.realpath(first) == os.path.realpath(second)

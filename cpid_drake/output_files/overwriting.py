"""The rule that protects files that exist already; it is the same for all outputs.

- No output is also an input or another output of the same command, whatever its name.
- A file that exists is replaced only by its like: a page by a page, a result by a result. YAML
  files and models are never replaced, because people edit them. `--force` lifts this point.
- A new file does not get the ending of another kind. `--force` lifts this point too.
"""

import os
import stat
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from cpid_drake.errors import InputError

_MOST_READ = 1 << 20


@dataclass(frozen=True)
class Kind:
    """A kind of output files.

    Attributes:
        name: the kind in messages, such as "an HTML page".
        endings: endings of its files, in lower case.
        start: the first characters of such a file, in lower case; empty if any file may begin so.
        marks: texts in the first MiB of such a file.
        is_edited: whether people edit such files by hand, so that none is replaced.

    """

    name: str
    endings: tuple[str, ...]
    start: bytes = b""
    marks: tuple[bytes, ...] = ()
    is_edited: bool = False

    def is_kind_of(self, path: Path) -> bool:
        """Return whether the contents of a file are of this kind; an empty file is of any kind."""
        with path.open("rb") as file:
            data = file.read(_MOST_READ if self.marks else 1000)
        begins = data.removeprefix(b"\xef\xbb\xbf").lstrip().lower().startswith(self.start)
        return not data or (begins and all(mark in data for mark in self.marks))


PAGE = Kind("an HTML page", (".html", ".htm"), b"<!doctype html")
RESULT = Kind("a result of `cpid identify`", (".json",), b"{", (b'"covariance"', b'"estimator"'))
VALIDATION = Kind(
    "a validation of `cpid validate`", (".json",), b"{", (b'"in_sigma"', b'"is_valid"')
)
SUMMARY = Kind("a summary of `cpid`", (".json",), b"{", (b'"wall_seconds"',))
TRUTH = Kind("a true target of `cpid simulate`", (".json",), b"{", (b'"inertia_entries"',))
PNG = Kind("a PNG picture", (".png",), b"\x89png")
SVG = Kind("an SVG picture", (".svg",), b"<?xml", (b"<svg",))
YAML = Kind("a YAML file", (".yaml", ".yml"), is_edited=True)
MODEL = Kind("a model", (".urdf", ".sdf", ".xml", ".mjcf", ".dmd.yaml"), is_edited=True)
CSV_LOG = Kind("a CSV log", (".csv",), marks=(b"time",))
NPZ_LOG = Kind("an NPZ log", (".npz",), b"pk")
PARQUET_LOG = Kind("a Parquet log", (".parquet",), b"par1")

LOGS = (CSV_LOG, NPZ_LOG, PARQUET_LOG)
"""The kinds of logs that are written."""

_KINDS = (PAGE, RESULT, PNG, SVG, YAML, MODEL, *LOGS)
_OTHER_ENDINGS = (".mat", ".db3", ".mcap", ".obj", ".stl", ".dae", ".gltf", ".py", ".md")
_ENDINGS = (*(ending for kind in _KINDS for ending in kind.endings), *_OTHER_ENDINGS)


@dataclass(frozen=True)
class Output:
    """A file that a command writes.

    Attributes:
        option: the option that names it, for messages; empty if there is none.
        path: its place.
        kind: its kind.

    """

    option: str
    path: Path
    kind: Kind


def check_outputs(
    outputs: Sequence[Output], inputs: Iterable[str | Path] = (), *, force: bool = False
) -> None:
    """Before the work begins, refuse outputs that cannot be written or would destroy a file.

    Args:
        outputs: the files that the command writes.
        inputs: the files and folders that the command reads; those that do not exist are ignored.
            All files in a folder are inputs, except those of the kind of the output.
        force: whether files of another kind may be replaced. Inputs are protected in any case.

    Raises:
        InputError: see the rule above; also if a path is that of a folder or of a device, or if
            nothing can be written there.

    """
    inputs = list(inputs)
    for k, output in enumerate(outputs):
        where = f"{output.option} {output.path!s:.200}".strip()
        try:
            _check_place(output.path, where)
            for other in outputs[:k]:
                if _is_same(output.path, other.path):
                    raise InputError(f"{where}: two outputs cannot be the same file")
            for source in inputs:
                _check_input(output, Path(source), where)
            if not force:
                _check_kind(output, where)
        except OSError as error:
            raise InputError(f"{where}: cannot write there: {error.strerror}") from error


def check_folder(
    option: str,
    folder: Path,
    files: Sequence[tuple[str, Kind]],
    inputs: Iterable[str | Path] = (),
    *,
    force: bool = False,
) -> None:
    """Before the work begins, refuse a folder in which these files cannot be written.

    Raises:
        InputError: the folder cannot be made or written in; or as for `check_outputs`.

    """
    where = f"{option} {folder!s:.200}"
    try:
        nearest = next(each for each in (folder, *folder.absolute().parents) if each.exists())
        _probe(nearest)
    except OSError as error:
        raise InputError(f"{where}: cannot write there: {error.strerror}") from error
    if folder.exists():
        outputs = [Output(option, folder / name, kind) for name, kind in files]
        check_outputs(outputs, inputs, force=force)


def _check_place(path: Path, where: str) -> None:
    if not path.parent.is_dir():
        raise InputError(f"{where}: there is no folder {path.parent}")
    if path.is_dir():
        raise InputError(f"{where}: is a folder; name a file")
    if path.exists() and not stat.S_ISREG(path.stat().st_mode):
        raise InputError(f"{where}: is a device or a pipe; name a file")
    _probe(Path(os.path.realpath(path)).parent)


def _probe(folder: Path) -> None:
    """Raise an OSError if a file cannot be made in a folder."""
    with tempfile.TemporaryFile(dir=folder):
        pass


def _check_input(output: Output, source: Path, where: str) -> None:
    files = [source]
    if source.is_dir():
        files = [f for f in source.iterdir() if f.suffix.lower() not in output.kind.endings]
    for file in files:
        if _is_same(output.path, file):
            raise InputError(
                f"{where}: is the input {file}, which would be lost; give another name"
            )


def _check_kind(output: Output, where: str) -> None:
    path, kind = output.path, output.kind
    name = path.name.lower()
    if not name.endswith(kind.endings) and name.endswith(_ENDINGS):
        raise InputError(
            f"{where}: the output is {kind.name}: end its name in {' or '.join(kind.endings)}, or "
            "add --force"
        )
    if path.exists() and (kind.is_edited or not kind.is_kind_of(path)):
        is_other = "" if kind.is_edited else f", and is not {kind.name}"
        raise InputError(
            f"{where}: exists already{is_other}; give another name, or replace it with --force"
        )


def _is_same(first: Path, second: Path) -> bool:
    """Return whether two paths refer to the same file, also through links."""
    if first.exists() and second.exists():
        return first.samefile(second)
    return os.path.realpath(first) == os.path.realpath(second)

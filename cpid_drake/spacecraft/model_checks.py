"""Checks on a model's files before Drake reads them.

Drake's readers read "1,5" as 1, "500mm" as 500 and a misspelt attribute as zero. They do not
return from a file that includes itself, or from a few YAML aliases that expand to billions.
"""

import re
from codecs import BOM_UTF8
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers.expat import ExpatError, ParserCreate, errors

import numpy as np
import yaml

from cpid_drake.errors import InputError, choose_from
from cpid_drake.input_files.yaml_text import check_size, yaml_errors
from cpid_drake.resources import package_folder

LARGEST_FILE = 64 * 2**20
"""Largest file that is read [bytes]; models that contain their geometry have a few million."""

LARGEST_NUMBER = 1e12
"""Largest mass, length or inertia that is accepted [SI units]."""

DEEPEST, MOST_FILES, LONGEST_NAME = 100, 1000, 1000
"""Most levels of nested elements or includes, most included files, most characters of a name."""

_INERTIA = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
# The attributes (URDF: by element; MJCF) or elements (SDF) that contain numbers.
_URDF_NUMBERS = {
    "mass": ("value",),
    "inertia": _INERTIA,
    "origin": ("xyz", "rpy"),
    "axis": ("xyz",),
    "limit": ("lower", "upper", "velocity", "effort"),
}
_SDF_NUMBERS = ("mass", *_INERTIA, "pose", "xyz", "lower", "upper", "velocity", "effort")
_MJCF_NUMBERS = (
    *("mass", "density", "diaginertia", "fullinertia", "pos", "quat", "euler", "axisangle"),
    *("xyaxes", "zaxis", "axis", "fromto", "size"),
)
_LIMITS = ("lower", "upper", "velocity", "effort")
_COUNTS = {"xyz": 3, "rpy": 3, "pos": 3, "quat": 4, "diaginertia": 3, "fullinertia": 6}
_COUNTS |= dict.fromkeys(("mass", "value", "density", *_INERTIA, *_LIMITS), 1)
_NOT_NEGATIVE = ("mass", "value", "density", "size", "diaginertia", "ixx", "iyy", "izz")


@dataclass
class FileContents:
    """What Drake does not tell of a model's files.

    Attributes:
        efforts: effort limits in URDF files [N·m or N], by joint. Drake reads an effort limit only
            if the joint has a transmission too.
        hollow: links of URDF and SDF files that have a geometry and no inertia. Drake takes their
            mass for zero (URDF) or for 1 kg (SDF).

    """

    efforts: dict[str, float] = field(default_factory=dict)
    hollow: set[str] = field(default_factory=set)


def check_model(path: Path, where: str, folders: Mapping[str, Path]) -> FileContents:
    """Check a model that Drake might never finish reading, or might read with other numbers.

    Args:
        path: the model's file.
        where: its name in error messages.
        folders: folders of the packages that its URIs refer to, by name.

    Raises:
        InputError: the file, or one that it includes, is not XML or YAML, is too large or nested
            too deeply, includes itself, or contains entities, text in place of a number, or
            numbers out of range. The message names the file and the line.

    """
    try:
        walk = _Walk(where, path, folders)
        walk.visit(path, ())
    except InputError:
        raise
    except (OSError, ValueError, RuntimeError) as error:  # too long, with NUL, or a circle of links
        raise InputError(f"{where}: a file that it names cannot be read: {error!s:.200}") from error
    return walk.contents


@dataclass
class _Walk:
    """A walk from a model's file through the files that it includes."""

    where: str
    start: Path
    folders: Mapping[str, Path]
    count: int = 0
    contents: FileContents = field(default_factory=FileContents)

    def visit(self, path: Path, around: tuple[Path, ...]) -> None:
        """Check a file and the files that it includes; the files `around` include it."""
        path = path.resolve()
        self.count += 1
        place = self.where if path == self.start else f"{self.where}: {path}"
        if path in around:
            raise InputError(f"{place}: the file includes itself")
        if self.count > MOST_FILES or len(around) > DEEPEST:
            raise InputError(
                f"{place}: more than {MOST_FILES} includes, or more than {DEEPEST} nested levels"
            )
        ending = path.suffix.lower()
        if ending not in (".urdf", ".sdf", ".xml", ".yaml", ".yml"):
            return
        if not path.is_file():
            if path.exists():
                raise InputError(f"{place}: not a file")
            return  # Drake's own error names the file that includes it
        if path.stat().st_size > LARGEST_FILE:
            raise InputError(f"{place}: larger than {LARGEST_FILE >> 20} MiB: not a model")
        data = path.read_bytes()
        if ending in (".yaml", ".yml"):
            included = [self._behind(uri) for uri in _included_by_directives(data, place)]
        else:
            reader = _XmlReader(ending, place, self.contents)
            reader.read(data)
            # MJCF paths start at the folder of the first MJCF file.
            main = next((file for file in around if file.suffix.lower() == ".xml"), path)
            included = [
                main.parent / uri if ending == ".xml" else self._behind(uri)
                for uri in reader.included
            ]
        for file in included:
            if file is not None and file.is_dir():
                for part in sorted(file.glob("*.sdf")):
                    self.visit(part, (*around, path))
            elif file is not None:
                self.visit(file, (*around, path))

    def _behind(self, uri: str) -> Path | None:
        """Return the path of a URI's file; None if Drake will refuse the URI."""
        scheme, separator, rest = uri.partition("://")
        if not separator:
            return None
        if scheme == "file":
            return Path(rest)
        name, _, relative = rest.partition("/")
        known = package_folder(name, self.folders) if scheme in ("package", "model") else None
        return known / relative if known else None


def _included_by_directives(data: bytes, where: str) -> list[str]:
    """Return the URIs of the files that model directives name."""
    with yaml_errors(where):
        text = data.decode("utf-8-sig")
        check_size(text, where)
        root = yaml.compose(text, Loader=yaml.SafeLoader)
    return [
        file.value
        for directives in _values(root, "directives")
        for directive in getattr(directives, "value", ())
        for kind in ("add_directives", "add_model")
        for body in _values(directive, kind)
        for file in _values(body, "file")
        if isinstance(file, yaml.ScalarNode)
    ]


def _values(node: object, key: str) -> list[yaml.Node]:
    if not isinstance(node, yaml.MappingNode):
        return []
    return [value for name, value in node.value if name.value == key]


def _blank(match: re.Match[bytes]) -> bytes:
    return b"\n" * match[0].count(b"\n")


@dataclass
class _XmlReader:
    """A reader that checks the elements of one XML file in their order.

    Attributes:
        ending: ending of the file's name; it decides what the elements mean.
        where: the file's name in error messages.
        contents: receives what Drake does not tell.
        included: the files that it includes, as written there.

    """

    ending: str
    where: str
    contents: FileContents
    included: list[str] = field(default_factory=list)
    _open: list[tuple[str, str]] = field(default_factory=list)  # tags and names
    _text: list[str] = field(default_factory=list)
    _parts: set[str] = field(default_factory=set)  # of the link that is open

    def read(self, data: bytes) -> None:
        """Check the whole file.

        Raises:
            InputError: see `check_model`.

        """
        if not data.strip():
            raise InputError(f"{self.where}: the file is empty")
        # Drake's reader accepts "--" and any bytes in comments, and a declaration that follows
        # blanks or names another encoding; they are blanked out here.
        data = re.sub(
            rb"\A\s*<\?xml.*?\?>|<!--.*?-->", _blank, data.removeprefix(BOM_UTF8), flags=re.S
        )
        try:
            data.decode("utf-8")
        except UnicodeDecodeError as error:
            line = data.count(b"\n", 0, error.start) + 1
            raise InputError(f"{self.where}: line {line}: not text in UTF-8") from error
        self._parser = parser = ParserCreate("utf-8")
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.CharacterDataHandler = self._text.append
        parser.EntityDeclHandler = self._entity
        try:
            parser.Parse(data, True)
        except ExpatError as error:
            place = f"line {error.lineno}, column {error.offset + 1}"
            text = errors.messages[error.code]
            raise InputError(f"{self.where}: {place}: not XML: {text}") from error

    def _place(self) -> str:
        """Return the current line and the innermost element with a name."""
        named = [f" of {tag} '{name}'" for tag, name in self._open[1:] if name]
        return f"{self.where}: line {self._parser.CurrentLineNumber}{(named or [''])[-1]}"

    def _inside(self, tag: str) -> bool:
        """Return whether the current element's parent has this tag."""
        return len(self._open) > 1 and self._open[-2][0] == tag

    def _entity(self, name: str, *_: object) -> None:
        raise InputError(f"{self._place()}: the entity &{name}; would not be read; write its text")

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        name = attributes.get("name", "")
        if len(name) > LONGEST_NAME:
            raise InputError(f"{self._place()}: a name of {len(name)} characters")
        self._open.append((tag, name))
        if len(self._open) > DEEPEST:
            raise InputError(f"{self._place()}: nested too deeply, more than {DEEPEST} levels")
        self._text.clear()
        if tag == "link":
            self._parts = set()
        elif self._inside("link"):
            self._parts.add(tag)
        if self.ending == ".xml":
            numbers = [key for key in _MJCF_NUMBERS if key in attributes]
            if tag == "include" and attributes.get("file"):
                self.included.append(attributes["file"])
        elif self.ending == ".urdf":
            numbers = [key for key in _URDF_NUMBERS.get(tag, ()) if key in attributes]
            for key in attributes:
                if self._inside("inertial") and key not in _URDF_NUMBERS.get(tag, (key,)):
                    choices = choose_from(key, _URDF_NUMBERS[tag])
                    raise InputError(
                        f"{self._place()}: <{tag}> has no attribute '{key}'; {choices}"
                    )
        else:
            numbers = []
        for key in numbers:
            self._check_numbers(key, attributes[key], f'<{tag} {key}="{{}}">')
        if "effort" in numbers and self._inside("joint"):
            self.contents.efforts[self._open[-2][1]] = float(attributes["effort"])

    def _end(self, tag: str) -> None:
        text = "".join(self._text).strip()
        self._text.clear()
        if self.ending == ".sdf" and tag in _SDF_NUMBERS and text:
            self._check_numbers(tag, text, f"<{tag}>{{}}</{tag}>")
        if self.ending == ".sdf" and tag == "uri" and self._inside("include"):
            self.included.append(text)
        if (
            tag == "link"
            and self._parts & {"visual", "collision"}
            and "inertial" not in self._parts
        ):
            self.contents.hollow.add(self._open[-1][1])
        self._open.pop()

    def _check_numbers(self, key: str, text: str, what: str) -> None:
        """Check that all words of a text are numbers in the range of this key."""
        words = text.split()
        problem = ""
        for word in words:
            try:
                value = float(word) if "_" not in word else np.nan
            except ValueError:
                value = np.nan
            if np.isnan(value) or (key not in _LIMITS and not np.isfinite(value)):
                problem = "is not a finite number; write numbers with a decimal point and no unit"
            elif key not in _LIMITS and abs(value) > LARGEST_NUMBER:
                problem = f"is out of range: its size is over {LARGEST_NUMBER:g}"
            elif key in _NOT_NEGATIVE and value < -1e-12:  # some models contain rounded zeros
                problem = "must not be negative"
            if problem:
                problem = f"{word:.40} {problem}"
                break
        if not problem and len(words) != _COUNTS.get(key, len(words)):
            problem = f"{_COUNTS[key]} numbers are needed, not {len(words)}"
        if problem:
            raise InputError(f"{self._place()}: {what.format(text[:60])}: {problem}")

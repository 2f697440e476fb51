"""The shipped models and scenarios, and the files that paths and model URIs refer to."""

from collections.abc import Mapping
from pathlib import Path

from cpid_drake.files.errors import InputError, choose_from

MODELS_PACKAGE = "cpid_drake_models"
_DRAKE = "drake"


def models_directory() -> Path:
    """Return the folder of the shipped models: in the package if installed, else the checkout's."""
    package = Path(__file__).resolve().parents[1]
    installed = package / "models"
    return installed if installed.is_dir() else package.parent / "models"


def version_of(package: str) -> str | None:
    """Return the version of an installed Python package; None if it is only on the path."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(package)
    except PackageNotFoundError:
        return None


__version__ = version_of("cpid-drake") or "unknown"
"""Version of this package; unknown if it is not installed."""


def package_folders(packages: Mapping[str, str | Path] | None = None) -> dict[str, Path]:
    """Return the folders of `cpid_drake_models` and of the given packages, by package name.

    Raises:
        InputError: a folder does not exist, or a name is already taken.

    """
    folders = {MODELS_PACKAGE: models_directory()}
    for name, folder in (packages or {}).items():
        if not Path(folder).is_dir():
            raise InputError(f"package '{name}': no such folder: {folder}")
        if name in folders or name == _DRAKE:
            raise InputError(f"package '{name}' is already known; choose another name")
        folders[name] = Path(folder)
    return folders


def resolve_model(uri: str | Path, folders: Mapping[str, Path] | None = None) -> Path:
    """Return the absolute path of the file that a path or a `package://NAME/...` URI names.

    Args:
        uri: a path, `~` included, or a URI.
        folders: the packages' folders by name; default: `package_folders()`.

    Raises:
        InputError: the package is unknown, the URI scheme is not `package`, or no such file exists.

    """
    text, folders = str(uri), package_folders() if folders is None else folders
    path = Path(text)
    if "://" in text:
        scheme, _, rest = text.partition("://")
        name, _, relative = rest.partition("/")
        if scheme != "package":
            raise InputError(f"{text}: give a path or a package:// URI, not {scheme}://")
        # Drake's package of models is unknown here, because Drake would download it.
        if name not in folders and name != _DRAKE:
            names = ", ".join(sorted([*folders, _DRAKE]))
            raise InputError(f"{text}: unknown package '{name}' (known: {names})")
        path = (folders[name] if name in folders else _folder_of_drake()) / relative
    try:
        path = path.expanduser()
        is_file, is_folder = path.is_file(), path.is_dir()
    except RuntimeError as error:  # the user in ~user does not exist
        raise InputError(f"{text}: {error}") from error
    except OSError as error:
        raise InputError(f"{text[:200]}: {error.strerror}") from error
    if not is_file:
        what = "a folder" if is_folder else "no such file"
        if path.exists() and not is_folder:  # it could be read without an end
            what = "not a file but a pipe or a device; save its contents in a file first"
        raise InputError(f"{text}: {what}" + ("" if path == Path(text) else f" ({path})"))
    return path.resolve()


def from_folder(folder: Path, path: str) -> str:
    """Return a path that a file contains; relative paths start at the file's folder.

    Raises:
        InputError: the path names a user that does not exist.

    """
    try:
        return path if "://" in path else str(folder / Path(path).expanduser())
    except RuntimeError as error:  # the user in ~user does not exist
        raise InputError(f"{path:.200}: {error}") from error


def _folder_of_drake() -> Path:
    from pydrake.multibody.parsing import PackageMap

    return Path(PackageMap().GetPath(_DRAKE))


def shipped_scenario(name: str) -> Path:
    """Return the path of a scenario that comes with the package, such as "paper".

    Raises:
        InputError: no shipped scenario has this name.

    """
    folder = models_directory() / "scenarios"
    path = folder / f"{name}.yaml"
    if not path.is_file():
        names = sorted(file.stem for file in folder.glob("*.yaml"))
        raise InputError(f"no shipped scenario '{name}'; {choose_from(name, names)}")
    return path


def find_scenario(name_or_path: str) -> Path | str:
    """Return the scenario file that a user means: a path, or a shipped one's name such as "paper".

    A name with an ending or a slash is a path or a package:// URI.

    Raises:
        InputError: the file does not exist, or no shipped scenario has this name.

    """
    if not (Path(name_or_path).suffix or "/" in name_or_path):
        return shipped_scenario(name_or_path)
    resolve_model(name_or_path)
    return name_or_path

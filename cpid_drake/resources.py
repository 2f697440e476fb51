"""Where the shipped models and scenarios are, and how a model URI becomes a path."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from cpid_drake.errors import InputError

if TYPE_CHECKING:  # Drake is imported where it is used: commands find missing files without it
    from pydrake.multibody.parsing import PackageMap

MODELS_PACKAGE = "cpid_drake_models"


def models_directory() -> Path:
    """Return the folder of the shipped models: in the package if installed, else the checkout's."""
    package = Path(__file__).resolve().parent
    installed = package / "models"
    return installed if installed.is_dir() else package.parent / "models"


def package_map(packages: Mapping[str, str | Path] | None = None) -> "PackageMap":
    """Return a PackageMap that knows `cpid_drake_models` and the given packages (name to folder).

    Raises:
        InputError: a folder does not exist, or a name is already taken.

    """
    from pydrake.multibody.parsing import PackageMap

    result = PackageMap()
    forget_remote_packages(result)
    result.Add(MODELS_PACKAGE, str(models_directory()))
    for name, folder in (packages or {}).items():
        if not Path(folder).is_dir():
            raise InputError(f"package '{name}': no such folder: {folder}")
        if result.Contains(name):
            raise InputError(f"package '{name}' is already known; choose another name")
        result.Add(name, str(folder))
    return result


def forget_remote_packages(packages: "PackageMap") -> None:
    """Take out what Drake would download when a model names it: reading a file fetches nothing."""
    if packages.Contains("drake_models"):
        packages.Remove("drake_models")


def resolve_model(uri: str | Path, packages: "PackageMap | None" = None) -> Path:
    """Return the file behind a path or a `package://NAME/...` URI.

    Raises:
        InputError: the package is unknown, the URI scheme is not `package`, or no such file exists.

    """
    text = str(uri)
    path = Path(text)
    if text.startswith("~"):
        try:
            path = path.expanduser()
        except RuntimeError as error:
            raise InputError(f"{text}: {error}") from error
    if "://" in text:
        scheme, _, rest = text.partition("://")
        name, _, relative = rest.partition("/")
        if scheme != "package":
            raise InputError(f"{text}: give a path or a package:// URI, not {scheme}://")
        if packages is None and name == MODELS_PACKAGE:
            folder = models_directory()
        else:
            packages = packages or package_map()
            if not packages.Contains(name):
                known = ", ".join(packages.GetPackageNames())
                raise InputError(f"{text}: unknown package '{name}' (known: {known})")
            folder = Path(packages.GetPath(name))
        path = folder / relative
    try:
        is_file, is_folder = path.is_file(), path.is_dir()
    except OSError as error:
        raise InputError(f"{text[:200]}: {error.strerror}") from error
    if not is_file:
        found = "a folder" if is_folder else "not a file" if path.exists() else "no such file"
        raise InputError(f"{text}: {found}" + ("" if path == Path(text) else f" ({path})"))
    return path.resolve()

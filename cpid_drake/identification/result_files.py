"""The result of an identification as a JSON file."""

import json
from pathlib import Path

import numpy as np

from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS
from cpid_drake.files.checked_yaml import from_tree, load_json
from cpid_drake.files.drafts import write_text
from cpid_drake.files.dumping import to_tree
from cpid_drake.files.errors import InputError
from cpid_drake.files.resources import resolve_model
from cpid_drake.identification.result import FORMAT, Identification


def read_result(path: str | Path) -> Identification:
    """Read a result file.

    Raises:
        InputError: the file does not exist or is not JSON; a key is missing, unknown, repeated or
            of the wrong type; a number is not finite; the nearest rigid body is not physically
            consistent; or another version has written it.

    """
    with resolve_model(path).open("rb") as file:
        return _parse(file.read(), str(path))


def write_result(path: str | Path, result: Identification) -> None:
    """Write a result file, which `read_result` reads without loss.

    Raises:
        InputError: for the same reasons as `result_text`, or the file cannot be written.

    """
    write_text(path, result_text(result, str(path)))


def result_text(result: Identification, where: str) -> str:
    """Return the text of a result file.

    Args:
        result: the contents.
        where: the file's name in error messages.

    Raises:
        InputError: `read_result` would refuse the file.

    """
    text = json.dumps(to_tree(result), indent=2) + "\n"
    _parse(text.encode(), where)
    return text


def _parse(data: bytes, where: str) -> Identification:
    tree = load_json(data, where)
    if isinstance(tree, dict) and tree.get("format") != FORMAT:
        raise InputError(
            f'{where}: not a result of this version of cpid-drake, which has "format": {FORMAT}; '
            "identify from the log again"
        )
    result = from_tree(Identification, tree, where, "a result")
    expected = (("names", result.names, PARAMETER_NAMES), ("units", result.units, PARAMETER_UNITS))
    for key, given, right in expected:
        if given != right:
            raise InputError(f"{where}: {key} must be {', '.join(right)}")
    size = 0.0 if result.nearest is None else np.abs(result.nearest).max()
    if size > 1e90:  # products of larger numbers overflow
        raise InputError(f"{where}: nearest: {size:g} is too large for a rigid body")
    problems = [] if result.consistent is None else result.consistent.inconsistencies()
    if problems:
        raise InputError(f"{where}: nearest: no rigid body has these: {'; '.join(problems)}")
    return result

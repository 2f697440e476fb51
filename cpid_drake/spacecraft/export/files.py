"""Writes the target as a model file, alone or attached to the user's own spacecraft.

Every number is written with all its digits. Before a file gets its final name, Drake reads it, and
the result is compared with the input.
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import chain, count
from pathlib import Path

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, FrameIndex, JointIndex, ModelInstanceIndex

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.tree import TreeBody
from cpid_drake.errors import InputError
from cpid_drake.output_files.drafts import draft_of
from cpid_drake.output_files.overwriting import MODEL, Output, check_outputs
from cpid_drake.spacecraft.export.target_models import (
    FORMATS,
    directives,
    joint_name,
    target_alone,
    target_attached,
)
from cpid_drake.spacecraft.spacecraft import Spacecraft

_TOLERANCE = 1e-12
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,63}")


@dataclass(frozen=True)
class Exported:
    """The files of an exported target.

    Attributes:
        name: name of the target's link (or body).
        files: the requested file, and the file that it refers to, if any.

    """

    name: str
    files: tuple[Path, ...]


def export_target(
    parameters: InertialParameters,
    path: str | Path,
    *,
    format: str,
    spacecraft: Spacecraft | None = None,
    name: str | None = None,
    overwrite: bool = False,
) -> Exported:
    """Write the target as a model file; its link's frame is the capture frame C.

    Readers round numbers. A flat or rod-shaped body whose principal axes are not C's axes is
    therefore written with principal moments larger by 1e-13 of their sum, which readers accept.

    Args:
        parameters: physically consistent inertial parameters.
        path: the file to write, in a folder that exists.
        format: "urdf", "sdf" or "mjcf", or "drake-yaml" for Drake model directives. Directives
            contain absolute paths; they add the target's URDF, which is written beside them.
        spacecraft: if given, the file contains its model with the target fixed on C. For URDF, SDF
            and MJCF it is an edited copy that keeps the comments; directives work for any model.
        name: name of the target's link; default: `target`, with a number if that name is taken.
        overwrite: whether an existing `path` is replaced.

    Raises:
        InputError: no rigid body has the parameters, the format is unknown, the name is taken or
            not plain, the file exists, the folder cannot be written to, the spacecraft's model has
            another format or several files, or Drake does not read the file as intended. In all
            these cases no file is written.

    """
    path = Path(path)
    problems = parameters.infeasibilities()
    if problems:
        raise InputError(f"{path}: not written: no rigid body has this: {'; '.join(problems)}")
    if format not in FORMATS:
        raise InputError(f"no format '{format}'; choose from {', '.join(FORMATS)}")
    ending = FORMATS[format]
    if not path.name.endswith(ending) or path.name == ending:
        raise InputError(f"{path}: the name of a file in format {format} must end in {ending}")
    name = _free_name(name, spacecraft)
    target = _clear_of_the_limits(parameters)

    def check(file: Path) -> None:
        if spacecraft is None:
            _check_alone(file, name, parameters)
        else:
            _check_attached(spacecraft.with_model(file), spacecraft, name, parameters)

    beside = path.with_name(f"{path.name.removesuffix(ending)}_{name}.urdf")
    places = (path, beside) if format == "drake-yaml" else (path,)
    known = () if spacecraft is None else (spacecraft.path,)
    check_outputs([Output("", place, MODEL) for place in places], known, force=overwrite)
    if format != "drake-yaml":
        data = (
            target_alone(target, name, format).encode()
            if spacecraft is None
            else target_attached(target, name, format, spacecraft, path)
        )
        with draft_of(path) as draft:
            draft.write_bytes(data)
            with _read_back_errors(path, draft):
                check(draft)
        return Exported(name, places)

    # The target's file is moved to its place first, because the directives refer to it.
    with draft_of(path) as draft, draft_of(beside) as draft_beside:
        draft_beside.write_text(target_alone(target, name, "urdf"), encoding="utf-8")
        with _read_back_errors(beside, draft_beside):
            _check_alone(draft_beside, name, parameters)
        draft.write_text(directives(draft_beside, name, spacecraft), encoding="utf-8")
        with _read_back_errors(path, draft_beside, draft):
            check(draft)
        draft.write_text(directives(beside, name, spacecraft), encoding="utf-8")
    return Exported(name, places)


# -- names and numbers ---------------------------------------------------------------------------


def _free_name(name: str | None, spacecraft: Spacecraft | None) -> str:
    """Return a name that is free for the target's link, model instance and (with "_weld") joint."""
    if name is not None and not _NAME.fullmatch(name):
        raise InputError(
            f"the name {name!r:.80} cannot be used: a letter, then letters, digits, _ and - (at "
            "most 64)"
        )
    taken = {"world"}
    if spacecraft is not None:
        plant = spacecraft.plant
        taken |= {plant.get_frame(FrameIndex(k)).name() for k in range(plant.num_frames())}
        taken |= {plant.get_body(BodyIndex(k)).name() for k in range(plant.num_bodies())}
        taken |= {plant.get_joint(JointIndex(k)).name() for k in plant.GetJointIndices()}
        for k in range(plant.num_model_instances()):
            taken |= set(plant.GetModelInstanceName(ModelInstanceIndex(k)).split("::"))
    choices = [name] if name else chain(["target"], (f"target_{k}" for k in count(2)))
    for choice in choices:
        if not {choice, joint_name(choice)} & taken:
            return choice
    raise InputError(f"the name '{name}' is taken already; choose another")


def _clear_of_the_limits(target: InertialParameters) -> InertialParameters:
    """Return parameters that remain physically consistent after a reader has rounded them."""
    inertia, total = target.I_TTcm_C, np.trace(target.I_TTcm_C)
    low, middle, high = target.principal_moments()
    along_axes = not np.any(inertia - np.diag(np.diag(inertia)))
    exact = along_axes and low > 0 and low + middle >= high
    if exact or min(low, low + middle - high) > 1e-13 * total:
        return target
    return InertialParameters(target.mass, target.p_CTcm_C, inertia + 1e-13 * total * np.eye(3))


# -- checking what was written --------------------------------------------------------------------


@contextmanager
def _read_back_errors(path: Path, *drafts: Path) -> Iterator[None]:
    """Name the file in the messages of a check, instead of its draft."""
    try:
        yield
    except InputError as error:
        problem = str(error)
        for draft in drafts:
            problem = problem.replace(str(draft), "the file")
        raise InputError(f"{path}: not written, Drake reads it otherwise: {problem}") from error


def _check_alone(file: Path, name: str, target: InertialParameters) -> None:
    plant = MultibodyPlant(time_step=0.0)
    try:
        Parser(plant).AddModels(file)
        plant.Finalize()
    except (RuntimeError, ValueError, SystemExit) as error:
        raise InputError(str(error)) from error
    if plant.num_bodies() != 2 or not plant.HasBodyNamed(name):
        raise InputError(f"its one body is not '{name}'")
    inertia = plant.GetBodyByName(name).default_spatial_inertia()
    _require_equal(target, InertialParameters.from_spatial_inertia(inertia))


def _require_equal(meant: InertialParameters, read: InertialParameters) -> None:
    """Require equality to 1e-12 of each quantity's size.

    For the inertia, this size is that of the inertia about the body's origin.
    """
    reach = np.linalg.norm(meant.p_CTcm_C)
    size = np.trace(meant.I_TTcm_C) + meant.mass * reach**2
    scale = np.array([meant.mass] + 3 * [reach] + 6 * [size])
    if not (np.abs(read.to_vector() - meant.to_vector()) <= _TOLERANCE * scale).all():
        raise InputError(f"the target is {read}, not {meant}")


def _check_attached(
    joined: Spacecraft, spacecraft: Spacecraft, name: str, target: InertialParameters
) -> None:
    """Require an unchanged spacecraft and the target fixed on C, in position and attitude."""
    before, after = spacecraft.tree, joined.tree
    names = [body.name for body in after.bodies]
    if names.count(name) != 1:
        raise InputError(f"no body '{name}'")
    k = names.index(name)
    rest = after.bodies[:k] + after.bodies[k + 1 :]
    if not (
        joined.joint_names == spacecraft.joint_names
        and np.array_equal(joined.limits.rates, spacecraft.limits.rates)
        and len(rest) == len(before.bodies)
        and all(_same(old, new, k) for old, new in zip(before.bodies, rest))
    ):
        raise InputError("the spacecraft itself has changed")
    body = after.bodies[k]
    R_BT, p_BT = body.R_PF @ body.R_MB, body.p_PF + body.R_PF @ body.p_MB
    if not (
        body.parent == before.capture_body
        and np.abs(R_BT - before.R_BC).max() <= _TOLERANCE
        and np.abs(p_BT - before.p_BC).max() <= _TOLERANCE * max(1, np.abs(before.p_BC).max())
    ):
        raise InputError("the target is not fixed on the capture frame")
    _require_equal(target, InertialParameters(body.mass, body.p_BBcm, body.I_BBcm))


def _same(old: TreeBody, new: TreeBody, target: int) -> bool:
    """Return whether a body is unchanged; parent indices after the target's are shifted by one."""
    changed = replace(new, parent=new.parent - (new.parent > target))
    return all(np.array_equal(value, getattr(changed, key)) for key, value in vars(old).items())

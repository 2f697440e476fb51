"""The text of model files in URDF, SDF and MJCF, from a list of links."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from textwrap import indent
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform, RollPitchYaw

from cpid_drake.dynamics.inertia import InertialParameters

WHAT = "The captured target as identified by cpid_drake; its frame is the capture frame."
"""Comment at the beginning of every file."""

_MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")


def _numbers(values: ArrayLike) -> str:
    values = np.ravel(np.asarray(values, dtype=float))
    # Some readers refuse numbers below the smallest normal number.
    values = np.where(np.abs(values) < sys.float_info.min, 0.0, values)
    return " ".join(repr(value) for value in values.tolist())


@dataclass(frozen=True, eq=False)
class Link:
    """A link and the joint to its parent, whose frame at q = 0 is the link's own frame L.

    Attributes:
        body: mass, centre of mass and inertia in L; None without mass.
        kind: "revolute", "prismatic" or "fixed"; empty for the first link, which is free.
        limits: lowest and highest position, and largest rate; infinite for none.

    """

    name: str
    body: InertialParameters | None
    parent: str = ""
    joint: str = ""
    kind: str = ""
    X_PL: RigidTransform = field(default_factory=RigidTransform)
    axis_L: NDArray[np.float64] | None = None
    limits: tuple[float, float, float] = (-np.inf, np.inf, np.inf)

    @property
    def xyz(self) -> str:
        """Position of L in the parent's frame."""
        return _numbers(self.X_PL.translation())

    @property
    def rpy(self) -> str:
        """Roll, pitch and yaw of L in the parent's frame."""
        return _numbers(RollPitchYaw(self.X_PL.rotation()).vector())


def _finite(**values: float) -> dict[str, str]:
    return {key: _numbers(value) for key, value in values.items() if np.isfinite(value)}


def _attributes(values: dict[str, str]) -> str:
    return "".join(f" {key}={quoteattr(value)}" for key, value in values.items())


def _urdf(links: Sequence[Link]) -> str:
    parts = [f"<!-- {WHAT} -->\n"]
    for link in links:
        inertial, name = "", quoteattr(link.name)
        if link.body is not None:
            moments = dict(zip(_MOMENTS, map(_numbers, link.body.to_vector()[4:])))
            inertial = f"""
  <inertial>
    <origin xyz="{_numbers(link.body.p_CTcm_C)}" rpy="0 0 0"/>
    <mass value="{_numbers(link.body.mass)}"/>
    <inertia{_attributes(moments)}/>
  </inertial>"""
        parts.append(f"<link name={name}>{inertial}\n</link>\n")
        if not link.kind:
            continue
        low, high, rate = link.limits
        limits = _finite(lower=low, upper=high, velocity=rate)
        kind = "continuous" if link.kind == "revolute" and not limits else link.kind
        moves = ""
        if link.axis_L is not None:
            effort = {"effort": "0"} if limits else {}  # URDF requires it; 0 means that none is set
            moves = f'\n  <axis xyz="{_numbers(link.axis_L)}"/>'
            moves += f"\n  <limit{_attributes(limits | effort)}/>" if limits else ""
        parts.append(f"""\
<joint name={quoteattr(link.joint)} type="{kind}">
  <parent link={quoteattr(link.parent)}/>
  <child link={name}/>
  <origin xyz="{link.xyz}" rpy="{link.rpy}"/>{moves}
</joint>
""")
    model = quoteattr(links[0].name)
    return f'<?xml version="1.0"?>\n<robot name={model}>\n{"".join(parts)}</robot>\n'


def _sdf(links: Sequence[Link]) -> str:
    parts = [f"<!-- {WHAT} -->\n"]
    for link in links:
        inertial = pose = ""
        if link.kind == "fixed" and link.body is None:  # readers give a link without mass 1 kg
            parts.append(
                f"<frame name={quoteattr(link.name)} attached_to={quoteattr(link.parent)}>\n"
                f"  <pose>{link.xyz} {link.rpy}</pose>\n</frame>\n"
            )
            continue
        if link.body is not None:
            moments = zip(_MOMENTS, map(_numbers, link.body.to_vector()[4:]))
            inertial = f"""
  <inertial>
    <pose>{_numbers(link.body.p_CTcm_C)} 0 0 0</pose>
    <mass>{_numbers(link.body.mass)}</mass>
    <inertia>{"".join(f"<{key}>{value}</{key}>" for key, value in moments)}</inertia>
  </inertial>"""
        if link.kind:
            parent = quoteattr(link.parent)
            pose = f"\n  <pose relative_to={parent}>{link.xyz} {link.rpy}</pose>"
        parts.append(f"<link name={quoteattr(link.name)}>{pose}{inertial}\n</link>\n")
        if not link.kind:
            continue
        low, high, rate = link.limits
        limits = _finite(lower=low, upper=high, velocity=rate)
        axis = ""
        if link.axis_L is not None:
            inner = "".join(f"<{key}>{value}</{key}>" for key, value in limits.items())
            inner = f"<limit>{inner}</limit>" if inner else ""
            axis = f"\n  <axis><xyz>{_numbers(link.axis_L)}</xyz>{inner}</axis>"
        parts.append(f"""\
<joint name={quoteattr(link.joint)} type="{link.kind}">
  <parent>{quoteattr(link.parent)[1:-1]}</parent>
  <child>{quoteattr(link.name)[1:-1]}</child>{axis}
</joint>
""")
    model = f"<model name={quoteattr(links[0].name)}>\n{''.join(parts)}</model>"
    return f'<?xml version="1.0"?>\n<sdf version="1.9">\n{model}\n</sdf>\n'


def _mjcf(links: Sequence[Link]) -> str:
    def text(link: Link) -> str:
        inner = "" if link.kind else "<freejoint/>\n"
        place = ""
        if link.kind:
            quaternion = link.X_PL.rotation().ToQuaternion().wxyz()
            place = f' pos="{link.xyz}" quat="{_numbers(quaternion)}"'
        if link.axis_L is not None:
            low, high, _ = link.limits
            kind = "hinge" if link.kind == "revolute" else "slide"
            limited = ""
            if np.isfinite([low, high]).all():
                limited = f' limited="true" range="{_numbers([low, high])}"'
            inner += f'<joint name={quoteattr(link.joint)} type="{kind}"'
            inner += f' axis="{_numbers(link.axis_L)}"{limited}/>\n'
        if link.body is not None:
            vector = link.body.to_vector()
            inner += f'<inertial pos="{_numbers(link.body.p_CTcm_C)}" mass="{_numbers(vector[0])}"'
            inner += f' fullinertia="{_numbers(vector[4:])}"/>\n'
        inner += "".join(text(other) for other in links if other.parent == link.name)
        return f"<body name={quoteattr(link.name)}{place}>\n{indent(inner, '  ')}</body>\n"

    return (
        f'<mujoco model={quoteattr(links[0].name)}>\n<!-- {WHAT} -->\n<compiler angle="radian"/>\n'
        f"<worldbody>\n{text(links[0])}</worldbody>\n</mujoco>\n"
    )


WRITERS = {"urdf": _urdf, "sdf": _sdf, "mjcf": _mjcf}
"""By format, the function from links, inboard before outboard, to text."""

"""Parts of models in URDF, whose inertias and frames are skewed unless they are given."""

INERTIA = {"ixx": 2.0, "iyy": 3.0, "izz": 4.0, "ixy": 0.1, "ixz": -0.2, "iyz": 0.3}


def moments(*values: float) -> dict[str, float]:
    """Return xx, yy, zz and, if they are given, xy, xz, yz by their names in URDF."""
    return dict.fromkeys(INERTIA, 0.0) | dict(zip(INERTIA, values))


BALANCED = moments(1.0, 1.0, 1.0)


def link(name, mass=10.0, inner="", com="0.1 -0.2 0.3", com_rpy="0.2 0.1 -0.3", **inertia) -> str:
    entries = " ".join(f'{key}="{value}"' for key, value in (INERTIA | inertia).items())
    return (
        f'<link name="{name}"><inertial><origin xyz="{com}" rpy="{com_rpy}"/>'
        f'<mass value="{mass}"/><inertia {entries}/></inertial>{inner}</link>'
    )


def joint(
    name,
    parent,
    child,
    kind="revolute",
    axis="0.6 0 0.8",
    xyz="0.5 -0.1 0.2",
    rpy="0.3 -0.2 0.4",
    limits=(-2, 2.5),
    velocity=0.7,
) -> str:
    low, high = limits
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>'
        f'<limit lower="{low}" upper="{high}" effort="10" velocity="{velocity}"/></joint>'
    )


def urdf(*parts, name="mine") -> str:
    return f'<?xml version="1.0"?><robot name="{name}">{"".join(parts)}</robot>'

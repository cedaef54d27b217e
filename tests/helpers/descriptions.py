"""Robot descriptions for the tests of audit and repair."""

import numpy as np

from sdpid._common.arrays import Array
from sdpid.robot.description.bodies import TENSOR_NAMES
from sdpid.robot.inertia import physical_parameters, tensor_entries


def number(value: float) -> str:
    return repr(float(value))


def inertial(mass: float, com: Array, tensor: Array, rpy: str = "0 0 0") -> str:
    """Return an <inertial> with the numbers in full."""
    entries = " ".join(
        f'{key}="{number(value)}"'
        for key, value in zip(TENSOR_NAMES, tensor_entries(np.asarray(tensor)), strict=True)
    )
    xyz = " ".join(number(x) for x in com)
    return (
        f'<inertial><origin xyz="{xyz}" rpy="{rpy}"/><mass value="{number(mass)}"/>'
        f"<inertia {entries}/></inertial>"
    )


def diagonal(mass: float, *moments: float) -> str:
    """Return an <inertial> at the origin with these principal moments."""
    return inertial(mass, np.zeros(3), np.diag(moments))


def inertial_of(theta: Array) -> str:
    """Return the <inertial> of a body (10,)."""
    mass, com, tensor = physical_parameters(theta)
    return inertial(float(mass), com, tensor)


def box(size: float, kind: str = "collision") -> str:
    """Return a cube about the origin."""
    return f'<{kind}><geometry><box size="{size} {size} {size}"/></geometry></{kind}>'


def chain(*links: str, joints: tuple[str, ...] | None = None) -> str:
    """Return a URDF of links (what is inside them) hung one on another, on a base."""
    kinds = joints or ("continuous",) * len(links)
    parts = ['<?xml version="1.0"?>\n<robot name="chain">\n  <link name="base"/>']
    for k, (content, kind) in enumerate(zip(links, kinds, strict=True), start=1):
        parent = f"link{k - 1}" if k > 1 else "base"
        parts.append(f'  <link name="link{k}">{content}</link>')
        parts.append(
            f'  <joint name="joint{k}" type="{kind}"><parent link="{parent}"/>'
            f'<child link="link{k}"/><origin xyz="0.1 0 0.2" rpy="0.3 0 0.1"/>'
            '<axis xyz="0 0.6 0.8"/></joint>'
        )
    return "\n".join([*parts, "</robot>\n"])

"""Random robots as URDF: chains and trees, sliding and continuous joints, followers."""

import numpy as np

from sdpid._common.arrays import Array

KINDS = ("revolute", "revolute", "continuous", "prismatic")

# A follower comes after what it follows, so two joints at least.
_FEWEST_TO_FOLLOW = 2


def _numbers(values: Array) -> str:
    return " ".join(repr(float(x)) for x in values)


def _inertial(rng: np.random.Generator) -> str:
    """Return a body by principal moments, so that no reader has to take a tensor apart."""
    xx, yy, zz = rng.uniform(0.002, 0.05, 3).tolist()
    return (
        f'<inertial><origin xyz="{_numbers(rng.uniform(-0.2, 0.2, 3))}" '
        f'rpy="{_numbers(rng.uniform(-3.0, 3.0, 3))}"/><mass value="{rng.uniform(0.2, 3.0)!r}"/>'
        f'<inertia ixx="{yy + zz!r}" iyy="{xx + zz!r}" izz="{xx + yy!r}" ixy="0" ixz="0" '
        'iyz="0"/></inertial>'
    )


def random_tree(
    rng: np.random.Generator, joints: int, *, chain: bool = False, follower: bool = False
) -> tuple[str, tuple[float, float] | None]:
    """Return the URDF of a random robot, and multiplier and offset of the last joint.

    Parameters
    ----------
    rng : numpy.random.Generator
        What is random: places, axes, kinds of joints, bodies, and which link each one hangs on.
    joints : int
        Their number.
    chain : bool, optional
        Every link hangs on the one before.
    follower : bool, optional
        The last joint follows the first, and turns or slides as that does.
    """
    gear = None
    out = ['<robot name="random">', f'<link name="l0">{_inertial(rng)}</link>']
    kinds = [str(kind) for kind in rng.choice(KINDS, joints)]
    if follower and joints >= _FEWEST_TO_FOLLOW:
        kinds[0] = kinds[-1] = "revolute"
        gear = float(rng.uniform(-2.0, 2.0)), float(rng.uniform(-1.0, 1.0))
    for k, kind in enumerate(kinds, start=1):
        parent = k - 1 if chain else int(rng.integers(0, k))
        axis = rng.standard_normal(3)
        mimic = ""
        if gear is not None and k == joints:
            mimic = f'<mimic joint="j1" multiplier="{gear[0]!r}" offset="{gear[1]!r}"/>'
        out += [
            f'<link name="l{k}">{_inertial(rng)}</link>',
            f'<joint name="j{k}" type="{kind}"><parent link="l{parent}"/><child link="l{k}"/>'
            f'<origin xyz="{_numbers(rng.uniform(-0.5, 0.5, 3))}" '
            f'rpy="{_numbers(rng.uniform(-3.0, 3.0, 3))}"/>'
            f'<axis xyz="{_numbers(axis / np.linalg.norm(axis))}"/>'
            f'<limit lower="-3" upper="3" effort="50" velocity="2"/>{mimic}</joint>',
        ]
    return "".join([*out, "</robot>"]), gear

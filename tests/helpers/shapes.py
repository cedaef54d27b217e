"""Arms with shapes, for tests of distances."""

import numpy as np

import sdpid
from sdpid._common.arrays import Array
from sdpid.excitation.geometry.collision import CollisionModel

BALL = '<sphere radius="0.1"/>'
ROD = '<cylinder radius="0.05" length="0.4"/>'


def shaped_arm(
    *shapes: str, spacing: float = 0.5, kinds: str = "rrrrrr", more: str = ""
) -> sdpid.RobotModel:
    """Return a chain whose joints follow each other along x and turn about z and y in turn.

    Parameters
    ----------
    *shapes : str
        Geometry of the base and of each link, in the middle of the joint's frame; may be empty.
    spacing : float, optional
        From joint to joint, m.
    kinds : str, optional
        A letter a joint: r for turning, p for sliding along the axis.
    more : str, optional
        Further elements.
    """
    links, joints = [], []
    for i, shape in enumerate(shapes):
        own = f"<collision><geometry>{shape}</geometry></collision>" if shape else ""
        links.append(f'<link name="l{i}">{own}</link>')
    for i in range(1, len(shapes)):
        kind = "prismatic" if kinds[i - 1] == "p" else "revolute"
        axis = "0 0 1" if i % 2 else "0 1 0"
        joints.append(
            f'<joint name="j{i}" type="{kind}"><parent link="l{i - 1}"/><child link="l{i}"/>'
            f'<origin xyz="{spacing if i > 1 else 0} 0 0"/><axis xyz="{axis}"/>'
            '<limit lower="-2" upper="2" effort="9" velocity="3"/></joint>'
        )
    return sdpid.load_robot(f'<robot name="chain">{"".join(links + joints)}{more}</robot>')


def distances_and_gradients(model: CollisionModel, q: Array) -> tuple[Array, Array]:
    """Return the distances (K, P) and derivatives (K, P, n) that the search takes of each pair."""
    pairs = [model.only([p]) for p in range(len(model.pairs))]
    # Sharp enough to be the least distance itself.
    found = [pair.soft_minimum(q, 1e7, horizon=1e3) for pair in pairs]
    values, gradients = (np.stack(each, axis=1) for each in zip(*found, strict=True))
    return values, gradients

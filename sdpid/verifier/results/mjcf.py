"""MJCF as sdpid writes it, and nothing else."""

from __future__ import annotations

from ..reading import MalformedError, shown
from .markup import Node, parse

# The attributes of <joint> for friction and rotor inertia.
_FRICTION = {"frictionloss", "damping", "armature"}

# All that such a file holds: the children and the attributes of its elements. Others could change
# what the numbers mean.
_CHILDREN = {
    "mujoco": {"compiler", "option", "worldbody", "equality", "tendon"},
    "worldbody": {"body", "site"},
    "body": {"inertial", "joint", "freejoint", "body", "site"},
    "equality": {"joint", "connect", "weld"},
    "tendon": {"fixed"},
    "fixed": {"joint"},
}
_ATTRIBUTES = {
    "mujoco": {"model"},
    "option": {"gravity"},
    "body": {"name", "pos", "quat"},
    "inertial": {"pos", "quat", "mass", "diaginertia"},
    "freejoint": {"name"},
    # Where loops close.
    "site": {"name", "pos", "quat"},
    "connect": {"name", "site1", "site2"},
    "weld": {"name", "site1", "site2"},
    "joint": {"name", "type", "axis", "range", "actuatorfrcrange", *_FRICTION}
    | {"solreffriction", "solimpfriction"}
    | {"joint1", "joint2", "polycoef"}
    | {"joint", "coef"},
    "fixed": {"name", *_FRICTION},
}
_COMPILER = {"angle": "radian", "autolimits": "true", "inertiafromgeom": "false"}

# MuJoCo keeps this name for itself.
RENAMED = {"world": "world_link"}


def ours(source: str | bytes) -> Node:
    """Return the root of an MJCF; MalformedError where it holds what sdpid does not write."""
    root = parse(source)
    if root.tag != "mujoco":
        raise MalformedError(f"its root is <{shown(root.tag)}>, not <mujoco>")
    _require_known(root)
    return root


def _require_known(root: Node) -> None:
    waiting = [root]
    while waiting:
        node = waiting.pop()
        known = _ATTRIBUTES.get(node.tag, set())
        if node.tag == "compiler":
            known = {key for key, value in node.attributes.items() if _COMPILER.get(key) == value}
        for key in node.attributes.keys() - known:
            raise MalformedError(
                f"<{shown(node.tag)}> has {shown(key)}, which sdpid does not write"
            )
        for child in node.children:
            if child.tag not in _CHILDREN.get(node.tag, set()):
                raise MalformedError(f"it has <{shown(child.tag)}>, which sdpid does not write")
            waiting.append(child)
    compiler = root.only("compiler")
    if compiler is None or compiler.attributes != _COMPILER:
        raise MalformedError("its <compiler> is not the one that sdpid writes")

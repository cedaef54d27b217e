"""Audit the inertias of a URDF: which links are no real bodies.

    python examples/audit_urdf.py arm.urdf --out results

Without a file, a small robot with three mistakes that vendors really make is audited.
"""

import argparse
import json
from pathlib import Path

import sdpid

LINK = """<link name="{name}"><inertial><origin xyz="{com}"/><mass value="{mass}"/>
  <inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
JOINT = """<joint name="{child}_joint" type="revolute"><parent link="{parent}"/>
  <child link="{child}"/><axis xyz="0 0 1"/>
  <limit lower="-3" upper="3" effort="50" velocity="2"/></joint>"""

# An upper arm whose moments violate the triangle inequality, a forearm with a placeholder for a
# tensor, and a hand with a negative moment.
UPPER = {"name": "upper_arm", "com": "0.2 0 0", "mass": 3.0, "ixx": 0.01, "iyy": 0.02, "izz": 0.1}
FORE = {"name": "forearm", "com": "0.1 0 0", "mass": 2.0, "ixx": 1.0, "iyy": 1.0, "izz": 1.0}
HAND = {"name": "hand", "com": "0 0 0", "mass": 0.5, "ixx": -1e-4, "iyy": 1e-3, "izz": 1e-3}
EXAMPLE = "".join(
    ['<robot name="example"><link name="base"/>']
    + [LINK.format(**link) for link in (UPPER, FORE, HAND)]
    + [JOINT.format(parent=p["name"], child=c["name"]) for p, c in
       (({"name": "base"}, UPPER), (UPPER, FORE), (FORE, HAND))]
    + ["</robot>"]
)  # fmt: skip


def main() -> None:
    """Audit a description and write what was found."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("urdf", nargs="?", default=EXAMPLE, help="a URDF or MJCF file")
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--quick", action="store_true", help="changes nothing: it takes a moment")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    audit = sdpid.audit_urdf(options.urdf)
    print(audit.table(), audit.describe(), sep="\n\n")
    (options.out / "audit.json").write_text(json.dumps(audit.to_dict(), indent=1) + "\n")


if __name__ == "__main__":
    main()

"""Make ``denso_vp6242.urdf`` from ``kinematics.toml``.

The table is the source; the URDF says the same to tools that read no tables. It carries no
inertias: the case study identifies them. Run ``python make_urdf.py`` after editing the table; it
needs sdpid and nothing else. A test checks that the file is what this script writes.
"""

from __future__ import annotations

from pathlib import Path

from sdpid._common.files import atomic_write_text
from sdpid.robot.description.dh_table import DhTable

FOLDER = Path(__file__).resolve().parent
TARGET = FOLDER / "denso_vp6242.urdf"


def urdf_text() -> str:
    """Return the URDF of the kinematic table."""
    return DhTable.from_toml(FOLDER / "kinematics.toml").to_urdf()


def main() -> None:
    """Write the file."""
    atomic_write_text(TARGET, urdf_text())


if __name__ == "__main__":
    main()

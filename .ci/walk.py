"""Follow pages as a reader does: run their cells and commands, in order, in the current folder.

    python .ci/walk.py /checkout/docs/start.md /checkout/README.md

Cells run as in IPython, with whatever sdpid is installed; commands are the lines of console blocks
that begin with sdpid. The first that fails ends the walk.
"""

import re
import subprocess
import sys
from pathlib import Path

from IPython.core.interactiveshell import InteractiveShell

BLOCK = re.compile(r"^```(\{code-cell\} ipython3|console)\n(.*?)^```", flags=re.M | re.S)
# Currents without and with a load: files that only a reader with a robot has.
RECORDED = "--without a.csv --with b.csv"


def main(pages: list[str]) -> int:
    """Run the blocks of the pages, and return the exit status."""
    shell = InteractiveShell.instance()
    # A command that fails ends its cell, which IPython leaves to the reader.
    shell.system = ended_well
    import sdpid

    print(f"sdpid {sdpid.__version__} of {Path(sdpid.__file__).parent}")
    ran = 0
    for page in map(Path, pages):
        for kind, text in BLOCK.findall(page.read_text(encoding="utf-8")):
            for cell in [text] if kind.startswith("{") else commands(text):
                print(f"\n[{page.name}] {cell.strip().splitlines()[-1]}", flush=True)
                if not shell.run_cell(cell).success:
                    print(f"{page.name}: this block fails:\n{cell}", file=sys.stderr)
                    return 1
                ran += 1
    print(f"\n{ran} blocks ran")
    return 0 if ran else 1


def ended_well(command: str) -> None:
    """Run a command, which must end well."""
    subprocess.run(command, shell=True, check=True)


def commands(text: str) -> list[str]:
    """Return the commands of sdpid in a console block, as cells."""
    lines = (line.removeprefix("$ ") for line in text.splitlines())
    return [f"!{line}" for line in lines if line.startswith("sdpid ") and RECORDED not in line]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

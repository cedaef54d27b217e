"""Workers of joblib do not run modules of the current folder."""

import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from sdpid._common import jobs

SCRIPT = """
import math
from joblib import delayed
from sdpid._common.jobs import parallel

if __name__ == "__main__":
    print(parallel(2)(delayed(math.sqrt)(i) for i in (4, 9)))
"""


@pytest.mark.skipif(sys.version_info < (3, 11), reason="Python cannot leave the folder out before")
def test_modules_of_the_current_folder_are_not_run(tmp_path: Path) -> None:
    for name in ("joblib", "numpy", "cloudpickle"):
        (tmp_path / f"{name}.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\n")
    script = tmp_path / "scripts" / "script.py"
    script.parent.mkdir()
    script.write_text(SCRIPT)
    path = os.pathsep.join([str(Path(jobs.__file__).parents[2]), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, str(script)],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": path.rstrip(os.pathsep)},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.stdout.strip() == "[2.0, 3.0]", done.stderr
    assert not (tmp_path / "ran").exists()


def test_overlapping_uses_leave_the_environment_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    for before in (None, "x"):
        if before is None:
            monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
        else:
            monkeypatch.setenv("PYTHONSAFEPATH", before)
        inside, done = threading.Event(), threading.Event()

        def overlap(inside: threading.Event = inside, done: threading.Event = done) -> None:
            with jobs._safe_path:
                inside.set()
                done.wait(10.0)

        thread = threading.Thread(target=overlap)
        with jobs._safe_path:
            thread.start()
            inside.wait(10.0)
        assert os.environ["PYTHONSAFEPATH"] == "1"
        done.set()
        thread.join()
        assert os.environ.get("PYTHONSAFEPATH") == before

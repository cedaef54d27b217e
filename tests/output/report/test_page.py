"""What all pages share: a policy that lets named scripts run, and colors that can be read."""

import base64
import hashlib
import re
from importlib.resources import files

import pytest

from sdpid.output.report.page import policy

# Of text that is not large, by the accessibility guidelines (WCAG 2.2, 1.4.3).
CONTRAST = 4.5

# Every color of letters with what it stands on.
PAIRS = [
    *((ink, ground) for ink in ("ink", "soft", "link") for ground in ("bg", "card", "faint")),
    *((level, ground) for level in ("good", "caution", "bad") for ground in ("bg", "card")),
    *((ink, f"{level}-bg") for level in ("good", "caution", "bad") for ink in ("ink", level)),
]


def schemes() -> dict[str, dict[str, str]]:
    """Return the variables of the light scheme and of the dark one."""
    style = files("sdpid.output.report").joinpath("page.css").read_text(encoding="utf-8")
    blocks = re.findall(r":root \{(.*?)\}", style, flags=re.DOTALL)
    light, dark = (dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6})", block)) for block in blocks)
    return {"light": light, "dark": {**light, **dark}}


def luminance(color: str) -> float:
    shares = [int(color[k : k + 2], 16) / 255.0 for k in (1, 3, 5)]
    linear = [s / 12.92 if s <= 0.04045 else ((s + 0.055) / 1.055) ** 2.4 for s in shares]
    return sum(w * s for w, s in zip((0.2126, 0.7152, 0.0722), linear, strict=True))


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_letters_can_be_read(scheme: str) -> None:
    colors = schemes()[scheme]
    assert {"bg", "ink", "soft", "good", "bad", "caution", "link"} <= set(colors)
    for ink, ground in PAIRS:
        high, low = sorted((luminance(colors[ink]), luminance(colors[ground])), reverse=True)
        assert (high + 0.05) / (low + 0.05) >= CONTRAST, (ink, ground)


def test_only_given_scripts_run() -> None:
    assert "script-src" not in policy()
    assert "default-src 'none'" in policy().split("; ")
    script = "'use strict'; // <é>"
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in policy([script]).split("; ")

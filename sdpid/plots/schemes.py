"""Colors of pictures in a page that its reader sees in light or in dark.

A picture's own style sheet gives each color of the house a name with two values; the browser takes
the one of the page's scheme, in pictures within the page too.
"""

from __future__ import annotations

import re

from sdpid.plots.figures import (
    BLUE,
    FAINT,
    GRAY,
    GREEN,
    INK,
    ORANGE,
    PURPLE,
    RED,
    SHADE,
    SKY,
)

# Each color with that on a dark page: lighter, or dimmer where it is ground. There is no white
# behind a picture there.
_COLORS = {
    "ink": (INK, "#e6e9ed"),
    "gray": (GRAY, "#98a3af"),
    "faint": (FAINT, "#2a323b"),
    "shade": (SHADE, "#3d4752"),
    "blue": (BLUE, "#56b4e9"),
    "red": (RED, "#ff8a4c"),
    "green": (GREEN, "#3ecfa0"),
    "orange": (ORANGE, "#f2b632"),
    "purple": (PURPLE, "#dd97bd"),
    "sky": (SKY, "#8fd0f5"),
    "white": ("#ffffff", "none"),
}
_NAMED = {light.lower(): f"var(--{name})" for name, (light, _) in _COLORS.items()}
_COLOR = re.compile("|".join(_NAMED))


def _root(scheme: int) -> str:
    colors = (f"--{name}: {both[scheme].lower()}" for name, both in _COLORS.items())
    return f":root {{ {'; '.join(colors)} }}"


# Letters without a color of their own are black in SVG.
_STYLE = (
    f"<style>{_root(0)} text {{ fill: var(--ink) }} "
    f"@media (prefers-color-scheme: dark) {{ {_root(1)} }}</style>"
)


def in_both_schemes(svg: str) -> str:
    """Return an SVG of matplotlib's whose colors follow the scheme of the page it stands in."""
    named = re.sub(r' style="[^"]*"', lambda own: _COLOR.sub(_name, own[0]), svg)
    return named.replace("<defs>", f"{_STYLE}<defs>", 1)


def _name(color: re.Match[str]) -> str:
    return _NAMED[color[0]]

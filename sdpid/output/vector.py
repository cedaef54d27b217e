"""Panels under each other as one SVG picture, for a page: small, quick, and without a library.

A page shows dozens of panels. A general plotting library takes half a second for each figure and
writes a hundred kilobytes; lines, ticks and a few words need neither. Nothing in a picture has a
name of its own or points elsewhere, so that pictures can stand within the page itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from sdpid._arrays import Array, Mask
from sdpid.output.figures import FAINT, GREY, INK, SHADE, decimate, runs, spans

# Units of the picture; a phone shows it some 340 pixels wide, so letters of 12 are 10 pixels high.
WIDTH, _LETTERS = 420.0, 12.0

# Mean advance of a digit, as a share of the letters' size: digits of common fonts are 0.5 to 0.6.
_ADVANCE = 0.6

# Stretches along a line, of which the least and the greatest value are kept: more than a page shows
# of it in pixels would not be seen.
COLUMNS = 500

# Coordinates are whole numbers of so many parts of a unit: a fifth of a pixel on a wide screen.
_PARTS = 10

# Coordinates this far outside (in units) are cut: nothing of them is seen.
_OUTSIDE = 1e4

# About so many ticks an axis.
_TICKS_X, _TICKS_Y = 6, 5

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

# Powers of ten that are written out.
_PLAIN = range(-3, 5)


class Axis:
    """A scale: linear or logarithmic, from `low` to `high`, with its ticks.

    Parameters
    ----------
    low, high : float
        Its ends; a positive `low` where it is logarithmic.
    label : str, optional
        What it shows.
    log : bool, optional
        Whether it is logarithmic.
    count : int, optional
        About how many ticks.
    """

    def __init__(
        self, low: float, high: float, label: str = "", *, log: bool = False, count: int = _TICKS_Y
    ) -> None:
        if not high > low:
            # A line that does not vary: room around it, for which its own size is the measure.
            room = 0.1 * low if log else (0.1 * abs(low) or 1.0)
            low, high = low - room, high + room
        self.low, self.high, self.label, self.log = low, high, label, log
        self.ticks = _powers(low, high, count) if log else _steps(low, high, count)

    @classmethod
    def around(cls, label: str, *values: Array, room: float = 0.05) -> Axis:
        """Return a linear axis that all values fit on, with some room; NaN count as nothing."""
        known = np.concatenate([v[~np.isnan(v)] for v in values])
        low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
        return cls(low - room * (high - low), high + room * (high - low), label)

    @property
    def places(self) -> Array:
        """Where the ticks are: 0 at `low`, 1 at `high`."""
        return self.at(np.array([value for value, _ in self.ticks]))

    @property
    def words(self) -> list[str]:
        """Their numbers."""
        return [text for _, text in self.ticks]

    def at(self, values: Array) -> Array:
        """Return where values are: 0 at `low`, 1 at `high`."""
        if not self.log:
            return np.asarray((values - self.low) / (self.high - self.low))
        safe = np.log(np.maximum(values, np.finfo(float).tiny))
        return np.asarray((safe - np.log(self.low)) / np.log(self.high / self.low))


class Panel:
    """One pair of axes, and what is drawn between them.

    Parameters
    ----------
    x, y : Axis
        The axes.
    height : float
        Of the frame, in units of the picture.
    """

    def __init__(self, x: Axis, y: Axis, height: float) -> None:
        self.x, self.y, self.height = x, y, height
        self.keys: list[tuple[str, str]] = []
        self._layers: list[tuple[str, Array, Array, str, float]] = []

    def line(
        self, x: Array, y: Array, colour: str, width: float, *, label: str = "", dots: bool = False
    ) -> None:
        """Draw a line; of a long one the extremes of each of `COLUMNS` stretches."""
        self._layers.append(("line", *decimate(x, y, points=2 * COLUMNS), colour, width))
        if dots:
            self._layers.append(("dots", x, y, colour, 2.5))
        if label:
            self.keys.append((label, colour))

    def area(self, x: Array, low: Array, high: Array) -> None:
        """Shade what lies between two lines."""
        outline = np.concatenate([x, x[::-1]]), np.concatenate([low, high[::-1]])
        self._layers.append(("area", *outline, SHADE, 0.0))

    def shade(self, x: Array, flags: Mask) -> None:
        """Shade the stretches of x where a flag is set, over the full height."""
        self._layers.append(("spans", *spans(x, flags), SHADE, 0.0))

    def drawn(self, left: float, width: float) -> str:
        """Return what is within the frame; a picture in the picture cuts off what is beyond."""
        size = np.array([width, self.height]) * _PARTS
        areas, parts = [], []
        for kind, x, y, colour, thick in self._layers:
            if kind == "spans":
                ends = np.rint(self.x.at(np.stack([x, y], axis=1)) * size[0]).astype(np.int64)
                down = f"v{size[1]:.0f}"
                areas += [f"M{a} 0h{b - a}{down}h{a - b}z" for a, b in ends.tolist() if b > a]
                continue
            u = np.clip(self.x.at(x) * size[0], -_OUTSIDE, _OUTSIDE)
            v = np.clip((1.0 - self.y.at(y)) * size[1], -_OUTSIDE, _OUTSIDE)
            if kind == "area":
                areas.append(_path(u, v) + "z")
            elif kind == "dots":
                # Strokes without length and with round ends are dots.
                dots = "".join(f"M{a:.0f} {b:.0f}h0" for a, b in zip(u, v, strict=True))
                parts.append(_stroke(dots, colour, 2.0 * _PARTS * thick))
            else:
                parts.append(_stroke(_path(u, v), colour, _PARTS * thick))
        if areas:
            parts.insert(0, f'<path fill="{SHADE}" stroke="none" d="{"".join(areas)}"/>')
        return (
            f'<svg x="{left:g}" width="{width:g}" height="{self.height:g}" '
            f'viewBox="0 0 {size[0]:.0f} {size[1]:.0f}" fill="none" stroke-linejoin="round" '
            f'stroke-linecap="round">{"".join(parts)}</svg>'
        )


def picture(panels: Sequence[Panel], described: str) -> str:
    """Return panels under each other as SVG; the same panels give the same text.

    Parameters
    ----------
    panels : sequence of Panel
        From the top. Of those with the same horizontal axis only the last has its numbers.
    described : str
        What is shown, for those who do not see it.

    Returns
    -------
    str
    """
    longest = max((len(text) for panel in panels for text in panel.y.words), default=1)
    left = _LETTERS * (1.9 + _ADVANCE * longest)
    width = WIDTH - left - 0.8 * _LETTERS
    parts, top = [], 0.0
    for panel, below in zip(panels, [*panels[1:], None], strict=True):
        top += 1.7 * _LETTERS if panel.keys else 0.7 * _LETTERS
        numbers = below is None or below.x is not panel.x
        drawn = _panel(panel, left, width, numbers)
        parts.append(f'<g transform="translate(0 {top:g})">{drawn}</g>')
        top += panel.height + ((3.0 if panel.x.label else 1.6) * _LETTERS if numbers else 0.0)
    return (
        f'<svg viewBox="0 0 {WIDTH:g} {top:g}" role="img" aria-label="{escape(described)}" '
        f'font-size="{_LETTERS:g}" fill="{INK}">{"".join(parts)}</svg>'
    )


def _panel(panel: Panel, left: float, width: float, numbers: bool) -> str:
    """Return grid, content, frame and words of a panel whose frame begins at height zero."""
    grid, words, height = "", "", panel.height
    for u, text in zip(left + width * panel.x.places, panel.x.words, strict=True):
        grid += f"M{u:.1f} 0v{height:g}"
        if numbers:
            words += _text(u, height + 1.15 * _LETTERS, text, "middle")
    for v, text in zip(height * (1.0 - panel.y.places), panel.y.words, strict=True):
        grid += f"M{left:.1f} {v:.1f}h{width:.1f}"
        words += _text(left - 0.4 * _LETTERS, v + 0.35 * _LETTERS, text, "end")
    if numbers and panel.x.label:
        words += _text(left + 0.5 * width, height + 2.35 * _LETTERS, panel.x.label, "middle")
    if panel.y.label:
        place = f'transform="translate({0.85 * _LETTERS:g} {0.5 * height:g}) rotate(-90)"'
        words += f'<text {place} text-anchor="middle">{escape(panel.y.label)}</text>'
    if panel.keys:
        # Within one text, so that nothing need be known about the width of words.
        keys = "\u2003".join(
            f'<tspan fill="{colour}" font-weight="bold">—</tspan> {escape(label)}'
            for label, colour in panel.keys
        )
        place = f'x="{left + width:.1f}" y="{-0.5 * _LETTERS:g}"'
        words += f'<text {place} text-anchor="end">{keys}</text>'
    frame = f"M{left:.1f} 0v{height:g}h{width:.1f}"
    return (
        f'<path stroke="{FAINT}" d="{grid}"/>{panel.drawn(left, width)}'
        f'<path stroke="{GREY}" fill="none" d="{frame}"/>{words}'
    )


def _text(x: float, y: float, text: str, anchor: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(text)}</text>'


def _stroke(path: str, colour: str, width: float) -> str:
    return f'<path stroke="{colour}" stroke-width="{width:g}" d="{path}"/>'


def _path(u: Array, v: Array) -> str:
    """Return a line as steps of whole numbers, broken where a coordinate is NaN."""
    whole = ~(np.isnan(u) | np.isnan(v))
    parts = []
    for first, last in runs(whole):
        points = np.rint(np.stack([u[first:last], v[first:last]], axis=1)).astype(np.int64)
        steps = np.diff(points, axis=0)
        steps = steps[np.any(steps != 0, axis=1)]
        # A sign separates as well as a blank does.
        text = " ".join(f"{a} {b}" for a, b in steps.tolist()).replace(" -", "-")
        parts.append(f"M{points[0, 0]} {points[0, 1]}" + (f"l{text}" if text else "h0"))
    return "".join(parts)


def _steps(low: float, high: float, count: int) -> list[tuple[float, str]]:
    """Return ticks at multiples of 1, 2 or 5 times a power of ten, with their numbers."""
    rough = (high - low) / count
    power = 10.0 ** np.floor(np.log10(rough))
    step = float(power * next(m for m in (1.0, 2.0, 5.0, 10.0) if m * power >= 0.999 * rough))
    first, last = int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9))
    values = [k * step for k in range(first, last + 1)]
    digits = max(-int(np.floor(np.log10(step) + 1e-9)), 0)
    if digits <= 4 and max(abs(low), abs(high)) < 1e5:
        texts = [f"{value:.{digits}f}" for value in values]
    else:
        # All in the same power of ten, which each shows.
        scale = int(np.floor(np.log10(max(abs(low), abs(high)))))
        decimals = max(scale - int(np.floor(np.log10(step) + 1e-9)), 0)
        raised = str(scale).translate(_RAISED)
        texts = ["0" if v == 0.0 else f"{v / 10.0**scale:.{decimals}f}·10{raised}" for v in values]
    return [(v, t.replace("-", "−")) for v, t in zip(values, texts, strict=True)]


def _powers(low: float, high: float, count: int) -> list[tuple[float, str]]:
    """Return ticks at powers of ten; between them where there are fewer than two."""
    first, last = int(np.ceil(np.log10(low) - 1e-9)), int(np.floor(np.log10(high) + 1e-9))
    if last - first < 1:
        between = [m * 10.0**k for k in range(first - 1, last + 1) for m in (1, 2, 5)]
        return [(v, f"{v:.3g}".replace("-", "−")) for v in between if low <= v <= high]
    every = -(-(last - first + 1) // count)
    powers = range(first, last + 1, every)
    return [
        (10.0**k, f"{10.0**k:g}" if k in _PLAIN else f"10{str(k).translate(_RAISED)}")
        for k in powers
    ]

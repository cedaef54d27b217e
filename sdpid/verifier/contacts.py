"""What a certificate says of contacts: read carefully, and put into words."""

from __future__ import annotations

from typing import Any

from .reading import MalformedError, index, items, names, numbers, require_keys, shown

KEYS = (
    *("frames", "kinds", "offsets", "widened_s", "closed", "ranks"),
    *("force_deviations", "base_rows", "effort_deviations"),
)
_KINDS = ("point", "line", "plane")

# More contacts are not listed by name, and no robot has more.
_MOST_NAMES = 12
_MOST_CONTACTS = 1000


def contacts(origin: dict[str, Any], most: int) -> tuple[str, ...]:
    """Return what is said of contacts, in words: nothing where there are none.

    Parameters
    ----------
    origin : dict
        Of a certificate.
    most : int
        More samples than any log has.

    Raises
    ------
    MalformedError
        Where it makes no sense: samples that are counted twice, or kinds that are not known.
    """
    said = origin.get("contacts")
    if said is None:
        return ()
    require_keys(said, KEYS, "contacts")
    c = len(items(said["frames"], "frames"))
    if not 0 < c <= _MOST_CONTACTS:
        raise MalformedError(f"{c} contacts")
    # One link may touch the ground at several points.
    frames = [shown(name) for each in said["frames"] for name in names([each], 1, "frames")]
    kinds = items(said["kinds"], "kinds")
    if len(kinds) != c or not all(kind in _KINDS for kind in kinds):
        raise MalformedError(f"kinds of {c} contacts are {kinds!r:.80}")
    numbers(said["offsets"], c, 3)
    samples, n = index(origin["samples"], most), len(origin["joints"])
    closed = [index(each, samples + 1) for each in items(said["closed"], "closed")]
    ranks = [
        (index(rank, n + 1), index(count, samples + 1))
        for rank, count in (items(pair, "ranks") for pair in items(said["ranks"], "ranks"))
    ]
    distinct = len({rank for rank, _ in ranks}) == len(ranks)
    if len(closed) != c or not distinct or sum(count for _, count in ranks) != samples:
        raise MalformedError("contacts are not those of as many samples")
    shares = [100.0 * each / samples if samples else 0.0 for each in closed]
    listed = [
        f"{kind} {name} {share:.3g} %"
        for kind, name, share in zip(kinds, frames, shares, strict=True)
    ]
    more = f" and {c - _MOST_NAMES} more" if c > _MOST_NAMES else ""
    lost = ", ".join(f"{rank} in {count}" for rank, count in ranks)
    first = (
        f"Contacts, closed in a share of the samples: {', '.join(listed[:_MOST_NAMES])}{more}"
        f"{_widened(said)}; directions of forces eliminated: {lost} samples; "
        f"{_forces(said, c)}; {_efforts(said, n)}."
    )
    return (first,)


def _widened(said: dict[str, Any]) -> str:
    """Return by how much flags were widened, in words."""
    if said["widened_s"] is None:
        return ""
    return f", flags widened by {numbers(said['widened_s']):.6g} s on either side"


def _forces(said: dict[str, Any], c: int) -> str:
    """Return how well forces are known, in words."""
    given = said["force_deviations"]
    if given is None:
        return "no forces are measured"
    found = []
    for own in items(given, "force_deviations"):
        if len(items(own, "force_deviations")) != 6:
            raise MalformedError("deviations of forces are not six a contact")
        found += [numbers(each) for each in own if each is not None]
    if len(given) != c or min(found, default=0.0) < 0.0:
        raise MalformedError(f"deviations of forces are not those of {c} contacts")
    size = f" with errors up to {max(found):.4g} N (N.m)" if found else ""
    return f"forces are measured{size}"


def _efforts(said: dict[str, Any], n: int) -> str:
    """Return in which units errors of efforts count, in words."""
    base, given = index(said["base_rows"], n + 1), said["effort_deviations"]
    if given is None:
        return "each sample has its own covariance of efforts"
    values = numbers(given, n)
    if min(values, default=1.0) <= 0.0:
        raise MalformedError("a deviation of efforts is not positive")
    joints, floating = values[base:], values[:base]
    parts = []
    if floating:
        parts.append(f"{', '.join(f'{each:.4g}' for each in floating)} N and N.m at the base")
    if joints:
        parts.append(f"{min(joints):.4g} to {max(joints):.4g} N.m (N) at joints")
    return f"errors of efforts count in units of {', of '.join(parts)}"

"""Read robot descriptions as XML: decode, expand, parse safely, read and write frames, encode.

xacro files, URDF with macros, are expanded in a child process (extra ``xacro``).
"""

from __future__ import annotations

import codecs
import math
import os
import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array
from sdpid._common.extras import require
from sdpid._common.files import PathLike, Source, read_regular
from sdpid._common.sandbox import run_in_sandbox
from sdpid.errors import ModelError, SdpidError

# The largest robot description seen in the wild is below 1 MB; this bounds a hostile one.
MAX_BYTES = 64 * 2**20

# Seconds in which a xacro file is expanded.
TIMEOUT = 60.0

# Unicode categories that names must not have: names are printed, and could forge lines.
_CONTROLS = ("Cc", "Zl", "Zp")

# No length, mass or inertia of a robot is larger; squares of these are far from overflow.
LARGEST = 1e12

# Rotations by multiples of a right angle are written as exact zeros and ones: sin and cos of
# a rounded pi/2 differ from them by less than this.
_SNAP = 1e-15

_BYTE_ORDER_MARK = "\ufeff"
_DECLARATION = re.compile(r"^\ufeff?\s*<\?xml\s[^>]*?\?>")
_ENCODING = re.compile(r"\sencoding\s*=\s*[\"']([A-Za-z][\w.:-]*)[\"']", re.ASCII)


@dataclass(frozen=True)
class Description:
    """The text of a robot description and its source.

    Attributes
    ----------
    text : str
        Every character, a byte order mark included; `encode_xml` returns the file's bytes.
    path : Path or None
        The file, None for text.
    what : str
        What it is called in messages.
    source : Source or None
        The file's name, size and SHA-256; of text those of its UTF-8, without a name.
    expanded : bool
        Whether the text is the URDF that a xacro file stands for.
    """

    text: str
    path: Path | None
    what: str
    source: Source | None = None
    expanded: bool = False


def is_xml(source: object) -> bool:
    """Return whether a source is XML text rather than a name or a path."""
    return isinstance(source, str) and source.lstrip("\ufeff \t\r\n").startswith("<")


def read_description(source: str | os.PathLike[str]) -> Description:
    """Return a description from a file, or from its text.

    Raises
    ------
    ModelError
        When the file cannot be read, is larger than 64 MiB, or its bytes are not in the encoding
        that it declares.
    """
    if isinstance(source, str) and is_xml(source):
        origin = Source.of_bytes(source.encode("utf-8", "surrogatepass"), "")
        return Description(source, None, "description", origin)
    path = Path(source)
    data = read_regular(path, MAX_BYTES, ModelError)
    origin = Source.of_bytes(data, path.name)
    return Description(decode_xml(data, path.name), path, path.name, origin)


def decode_xml(data: bytes, what: str) -> str:
    """Return the text of an XML document in the encoding of its byte order mark or declaration.

    Raises
    ------
    ModelError
        When the encoding is unknown or the bytes are not in it.
    """
    if data.startswith((codecs.BOM_UTF16_LE, b"<\0")):
        encoding = "utf-16-le"
    elif data.startswith((codecs.BOM_UTF16_BE, b"\0<")):
        encoding = "utf-16-be"
    else:
        # All that a declaration consists of is the same in ASCII and what extends it.
        encoding = _declared_encoding(data[:200].decode("utf-8", "replace"))
    try:
        return data.decode(encoding)
    except (LookupError, UnicodeError) as cause:
        raise ModelError(
            f"cannot read {what}: it is not {encoding.upper()} text ({cause}); save it as UTF-8, "
            'or declare its encoding in the first line: <?xml version="1.0" encoding="..."?>.'
        ) from None


def encode_xml(text: str) -> bytes:
    """Return the bytes of an XML document in the encoding that it declares.

    UTF-16 is written with the low byte first, whatever the source's order was.

    Raises
    ------
    ModelError
        When the encoding is not known.
    """
    encoding = _declared_encoding(text)
    if codecs.lookup(encoding).name == "utf-16":
        encoding = "utf-16-le"
    try:
        return text.encode(encoding, "xmlcharrefreplace")
    except UnicodeError as cause:
        raise ModelError(
            f"XML: cannot be written in its encoding '{encoding}' ({cause})."
        ) from None


def _declared_encoding(text: str) -> str:
    """Return the name of the encoding that an XML text declares, UTF-8 by default."""
    declaration = _DECLARATION.match(text)
    found = _ENCODING.search(declaration.group()) if declaration else None
    encoding = found.group(1) if found else "utf-8"
    try:
        "".encode(encoding)
    except (LookupError, UnicodeError):
        raise ModelError(
            f"XML: the encoding '{encoding}' is not known; save the file as UTF-8."
        ) from None
    marked = text.startswith(_BYTE_ORDER_MARK) and not encoding.lower().startswith("utf-16")
    return "utf-8" if marked else encoding


def undeclared(text: str) -> str:
    """Return an XML text without byte order mark, leading space and declaration.

    Its declared encoding is that of a file and no longer that of the text.
    """
    return _DECLARATION.sub("", text, count=1).lstrip("\ufeff \t\r\n")


def parse_xml(text: str | bytes, what: str) -> Any:
    """Return the root element of an XML document. No entity is expanded, no network is used.

    Parameters
    ----------
    text : str or bytes
        The document.
    what : str
        What it is called in messages.

    Raises
    ------
    ModelError
        When it is not well-formed, declares a document type, is larger than 64 MiB, or has a name
        with a line end or another control character in it.
    """
    from lxml import etree

    if isinstance(text, bytes):
        text = decode_xml(text, what)
    # Line numbers in messages are those of the file.
    data = text.removeprefix(_BYTE_ORDER_MARK).lstrip().encode("utf-8", "surrogatepass")
    if len(data) > MAX_BYTES:
        raise ModelError(f"{what}: {len(data)} bytes of XML, more than the {MAX_BYTES} allowed.")
    parser = etree.XMLParser(
        encoding="utf-8", resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False
    )
    try:
        root = etree.fromstring(data, parser)
    except (etree.XMLSyntaxError, ValueError) as cause:
        raise ModelError(f"{what}: not well-formed XML ({cause}).") from None
    if root.getroottree().docinfo.doctype:
        raise ModelError(
            f"{what}: declares a document type; entities are not expanded, remove the declaration."
        )
    for element in root.iter(etree.Element):
        name = element.get("name", "")
        if any(unicodedata.category(c) in _CONTROLS for c in name):
            raise ModelError(
                f"{what}: the name {name!r} of a <{element.tag}> has a line end or another control "
                "character; rename it."
            )
    return root


def xml_text(root: Any, source: str) -> str:
    """Return the text of a document that was parsed from a source and then changed.

    Its byte order mark, declaration and line ends are the source's; white space within tags and
    quotes are those of the serializer.
    """
    from lxml import etree

    declaration = _DECLARATION.match(source)
    mark = _BYTE_ORDER_MARK if source.startswith(_BYTE_ORDER_MARK) else ""
    head = f"{declaration.group()}\n" if declaration else mark
    # With comments before and behind the root.
    nodes = [*reversed([*root.itersiblings(preceding=True)]), root, *root.itersiblings()]
    texts = [etree.tostring(each, encoding="unicode", with_tail=False) for each in nodes]
    text = head + "\n".join(texts)
    if source.endswith("\n"):
        text += "\n"
    return text.replace("\n", "\r\n") if "\r\n" in source else text


def add_child(parent: Any, child: Any, *, last: bool = False) -> None:
    """Add an element to another as its first or its last child, indented."""
    from lxml import etree

    level = 1 + sum(1 for _ in parent.iterancestors())
    etree.indent(child, level=level)
    if not len(parent):
        parent.text, child.tail = "\n" + level * "  ", "\n" + (level - 1) * "  "
    elif last:
        child.tail, parent[-1].tail = parent[-1].tail, parent.text
    else:
        child.tail = parent.text
    parent.insert(len(parent) if last else 0, child)


def is_mjcf(text: str, what: str) -> bool:
    """Return whether a description is MJCF: whether its root element is ``<mujoco>``.

    Raises
    ------
    ModelError
        When it is not well-formed XML.
    """
    return bool(parse_xml(text, what).tag == "mujoco")


def axis_rotation(axis: int, angle: float) -> Array:
    """Return the transform (4, 4) that turns about x (0), y (1) or z (2)."""
    c, s = math.cos(angle), math.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    transform = np.eye(4)
    transform[i, i], transform[i, j], transform[j, i], transform[j, j] = c, -s, s, c
    transform[np.abs(transform) < _SNAP] = 0.0
    return transform


def rpy_matrix(rpy: Sequence[float] | Array) -> Array:
    """Return the rotation (3, 3) of fixed-axis roll, pitch and yaw, as URDF means them."""
    roll, pitch, yaw = (float(angle) for angle in rpy)
    return (axis_rotation(2, yaw) @ axis_rotation(1, pitch) @ axis_rotation(0, roll))[:3, :3]


def matrix_rpy(rotation: ArrayLike) -> tuple[float, float, float]:
    """Return roll, pitch and yaw of a rotation matrix; at gimbal lock roll is zero."""
    R = np.asarray(rotation, dtype=np.float64)
    horizontal = math.hypot(R[0, 0], R[1, 0])
    pitch = math.atan2(-R[2, 0], horizontal)
    # Below this the two remaining angles are one: only their sum or difference exists.
    if horizontal < 1e-12:
        return 0.0, pitch, math.atan2(-R[0, 1], R[1, 1])
    return math.atan2(R[2, 1], R[2, 2]), pitch, math.atan2(R[1, 0], R[0, 0])


def read_numbers(
    element: Any, key: str, what: str, default: str = "0 0 0", count: int = 3
) -> Array:
    """Return the numbers (count,) of an element's attribute.

    Raises
    ------
    ModelError
        When they are not that many finite numbers of at most `LARGEST`; `what` names the element.
    """
    text = default if element is None else element.get(key, default)
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.array([])
    if len(values) != count or not (np.abs(values) <= LARGEST).all():
        raise ModelError(
            f"{what}: {key} is '{text[:60]}', expected {count} finite number{'s' * (count > 1)} of "
            f"at most {LARGEST:g}."
        )
    return values


def read_origin(owner: Any, what: str) -> Array:
    """Return the placement (4, 4) of an element's ``<origin>``, the identity without one.

    Raises
    ------
    ModelError
        When xyz or rpy are not three numbers; `what` names the origin.
    """
    return read_placement(owner.find("origin"), what)


def read_placement(element: Any, what: str) -> Array:
    """Return the placement (4, 4) in an element's attributes xyz and rpy, see `read_origin`."""
    placement = np.eye(4)
    placement[:3, 3] = read_numbers(element, "xyz", what)
    placement[:3, :3] = rpy_matrix(read_numbers(element, "rpy", what))
    return placement


def relative(frame: Array, other: Array) -> Array:
    """Return the placement (4, 4) of another frame in a frame, both placed in a third."""
    return np.asarray(np.linalg.solve(frame, other), dtype=np.float64)


def numbers(values: ArrayLike) -> str:
    """Return numbers as XML text, in the shortest form that reads back to the same float64."""
    # Adding zero turns -0.0 into 0.0.
    return " ".join(repr(float(value) + 0.0) for value in np.ravel(np.asarray(values)))


def is_xacro(found: Description) -> bool:
    """Return whether a description is xacro, by its file's name or its elements.

    Raises
    ------
    ModelError
        When it is not well-formed XML.
    """
    if found.path is not None and found.path.suffix == ".xacro":
        return True
    if "xacro" not in found.text:
        return False
    root = parse_xml(found.text, found.what)
    return any("xacro}" in str(element.tag) for element in root.iter())


def read_expanded(source: PathLike, arguments: Mapping[str, str] | None = None) -> Description:
    """Read a description as `read_description` does, and expand it if it is a xacro file."""
    return expand_xacro(read_description(source), arguments)


def expand_xacro(found: Description, arguments: Mapping[str, str] | None = None) -> Description:
    """Return the URDF that a xacro file stands for, and any other description as it is.

    xacro evaluates expressions of Python; the child process that does so has limits of memory and
    time, but reads and writes files as the user. Packages (``$(find …)``) are found above the
    file, in a ROS environment, and on ``ROS_PACKAGE_PATH``.

    Parameters
    ----------
    found : Description
        What was read.
    arguments : mapping, optional
        Values of ``<xacro:arg>``.

    Raises
    ------
    ModelError
        When it cannot be expanded, or there are arguments for what is no xacro file.
    MissingExtraError
        When xacrodoc is not installed.
    """
    if not is_xacro(found):
        if arguments is not None:
            raise ModelError(f"{found.what}: xacro_args are given, and it is no xacro file.")
        return found
    path = None if found.path is None else str(found.path.resolve())
    values = {str(key): str(value) for key, value in (arguments or {}).items()}
    text = run_in_sandbox(
        _expanded,
        *(found.text, path, values, found.what),
        subject=found.what,
        error=ModelError,
        timeout=TIMEOUT,
    )
    return replace(found, text=str(text), expanded=True)


def _expanded(text: str, path: str | None, arguments: dict[str, str], what: str) -> str:
    """Return the URDF of a xacro text, in a child process."""
    xacrodoc = require("xacrodoc", extra="xacro")
    folder = None
    if path is not None:
        xacrodoc.packages.walk_up_from(path)
        folder = Path(path).parent
        # Files that it includes are named relative to it.
        os.chdir(folder)
    try:
        document = xacrodoc.XacroDoc.from_string(text, subargs=arguments, rootdir=folder)
        return str(document.to_urdf_string())
    except SdpidError:
        raise
    except Exception as cause:  # macros raise whatever their expressions raise
        message = " ".join(str(cause).split()) or type(cause).__name__
        raise ModelError(
            f"{what}: xacro cannot expand it ({message[:300]}); give missing arguments as "
            "xacro_args."
        ) from None

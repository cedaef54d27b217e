"""Files of PyTorch (`.pt`): dictionaries of tensors, as PACE logs joints.

Such a file is a zip of one pickle and of raw numbers. Nothing is unpickled and torch is not needed:
the pickle's opcodes are followed here, and those that would call anything but the two functions
that rebuild tensors and dictionaries are refused.
"""

from __future__ import annotations

import pickletools
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sdpid.errors import DataError
from sdpid.experiment.readers.columns import LogTable
from sdpid.experiment.recording.stored import check_claim

# Kinds of storages, as NumPy calls their numbers; files are little-endian.
_KINDS = {
    f"torch {kind}Storage": name
    for kind, name in zip(
        ("Double", "Float", "Half", "Long", "Int", "Short", "Char", "Byte", "Bool"),
        ("<f8", "<f4", "<f2", "<i8", "<i4", "<i2", "i1", "u1", "?"),
        strict=True,
    )
}
# The only functions that a pickle may name.
_TENSOR, _DICTIONARY = "torch._utils _rebuild_tensor_v2", "collections OrderedDict"
_KNOWN = (*_KINDS, _TENSOR, _DICTIONARY)
# Opcodes that push what stands with them, and those that push something new.
_PUSHED = ("BINUNICODE", "SHORT_BINUNICODE", "BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT")
_NEW: dict[str, Callable[[], Any]] = {
    **{"EMPTY_DICT": dict, "EMPTY_LIST": list, "EMPTY_TUPLE": tuple},
    **{"NONE": lambda: None, "NEWTRUE": lambda: True, "NEWFALSE": lambda: False},
}
_TUPLES = {"TUPLE1": 1, "TUPLE2": 2, "TUPLE3": 3}
# What reading damaged archives and pickles can raise.
_DAMAGE = (
    *(zipfile.BadZipFile, OSError, EOFError, MemoryError, RuntimeError),
    *(ValueError, LookupError, TypeError, AttributeError),
)
# A pickle of more bytes than this is none of a log's.
_LARGEST = 1 << 24
_HOW = "save a dictionary of tensors: torch.save({'time': ..., 'dof_pos': ...}, file)."


class _Tensor(NamedTuple):
    """Where the numbers of a tensor are: the storage's kind and file, and how they lie in it."""

    kind: str
    key: str
    offset: int
    size: tuple[int, ...]
    stride: tuple[int, ...]


def load_torch(path: Path) -> LogTable:
    """List the tensors, and the lists of texts, of a dictionary that PyTorch saved.

    Other things in it are passed over.

    Raises
    ------
    DataError
        When the file is no zip as PyTorch 1.6 and later write it, or holds other objects.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            entries = {each.filename: each for each in archive.infolist()}
            name = next((each for each in entries if each.endswith("/data.pkl")), None)
            if name is None or entries[name].file_size > _LARGEST:
                raise DataError(f"is a zip without the data.pkl of a log; {_HOW}")
            if any(each.compress_type != zipfile.ZIP_STORED for each in entries.values()):
                raise DataError("is compressed, as PyTorch's files never are.")
            root = name.removesuffix("data.pkl")
            order = f"{root}byteorder"
            if order in entries and archive.read(order) != b"little":
                raise DataError("is of a big-endian machine; save it on another.")
            content = _followed(archive.read(name))
    except zipfile.BadZipFile:
        raise DataError(f"is no zip, as PyTorch 1.6 and later write them; {_HOW}") from None
    except _DAMAGE as cause:
        raise DataError(f"not a readable PyTorch file ({cause}).") from None
    arrays: dict[str, Callable[[], NDArray[Any]]] = {}
    for name, value in content.items() if isinstance(content, dict) else ():
        if isinstance(value, _Tensor):
            arrays[name] = partial(_numbers, path, root, name, value)
        elif isinstance(value, list) and all(isinstance(x, str) for x in value):
            arrays[name] = partial(np.asarray, [str(x) for x in value])
    if not arrays:
        raise DataError(f"holds no tensors; {_HOW}")
    return LogTable(arrays)


def _followed(pickled: bytes) -> Any:
    """Return what a pickle of tensors describes, without running any of it.

    Raises
    ------
    DataError
        At the first opcode or name that tensors do not need.
    """
    stack: list[Any] = []
    marks: list[int] = []
    memo: dict[int, Any] = {}

    def since_mark() -> list[Any]:
        at = marks.pop()
        taken, stack[at:] = stack[at:], []
        return taken

    given: Any
    for opcode, given, _ in pickletools.genops(pickled):
        code = opcode.name
        if code in _PUSHED:
            stack.append(given)
        elif code in _NEW:
            stack.append(_NEW[code]())
        elif code in _TUPLES:
            taken = stack[-_TUPLES[code] :]
            stack[-_TUPLES[code] :] = [tuple(taken)]
        elif code == "TUPLE":
            stack.append(tuple(since_mark()))
        elif code == "MARK":
            marks.append(len(stack))
        elif code in ("BINPUT", "LONG_BINPUT"):
            memo[given] = stack[-1]
        elif code in ("BINGET", "LONG_BINGET"):
            stack.append(memo[given])
        elif code == "GLOBAL":
            if given not in _KNOWN:
                what = given.replace(" ", ".")
                raise DataError(f"holds {what}, which is never run or read; {_HOW}")
            stack.append(given)
        elif code == "BINPERSID":
            _, kind, key, *_ = stack.pop()
            # Not by a number or a tuple: hashes of tuples within tuples go as deep as these.
            stack.append((_KINDS[_text(kind)], _text(key)))
        elif code == "REDUCE":
            arguments = stack.pop()
            stack.append(_made(stack.pop(), arguments))
        elif code in ("SETITEM", "SETITEMS"):
            pairs = since_mark() if code == "SETITEMS" else [stack.pop(-2), stack.pop()]
            stack[-1].update(zip(map(_text, pairs[::2]), pairs[1::2], strict=True))
        elif code in ("APPEND", "APPENDS"):
            added = since_mark() if code == "APPENDS" else [stack.pop()]
            stack[-1].extend(added)
        elif code not in ("PROTO", "STOP"):
            raise DataError(f"holds more than tensors (opcode {code}), which is not read; {_HOW}")
    (content,) = stack
    return content


def _text(given: Any) -> str:
    """Return what must be a text."""
    if not isinstance(given, str):
        raise TypeError(f"a {type(given).__name__} in place of a name")
    return given


def _made(function: str, arguments: Any) -> Any:
    """Return what the two functions that are known make."""
    if function == _DICTIONARY and not arguments:
        return {}
    if function != _TENSOR:
        raise ValueError("a call with other arguments than PyTorch's")
    (kind, key), offset, size, stride = arguments[:4]
    numbers = (offset, *size, *stride)
    if len(size) != len(stride) or any(type(k) is not int or k < 0 for k in numbers):
        raise DataError(f"holds a tensor of the size {size} and the strides {stride}.")
    return _Tensor(kind, key, offset, size, stride)


def _numbers(path: Path, root: str, name: str, tensor: _Tensor) -> NDArray[Any]:
    """Return the numbers of a tensor.

    Raises
    ------
    DataError
        When the file holds fewer than the tensor claims.
    """
    kind = np.dtype(tensor.kind)
    check_claim(path, name, tensor.size, kind.itemsize)
    reach = sum((k - 1) * step for k, step in zip(tensor.size, tensor.stride, strict=True))
    try:
        with zipfile.ZipFile(path) as archive:
            held = np.frombuffer(archive.read(f"{root}data/{tensor.key}"), kind)
    except _DAMAGE as cause:
        raise DataError(f"'{name}' is damaged ({cause}).") from None
    if 0 in tensor.size:
        return np.empty(tensor.size, kind)
    if tensor.offset + reach >= len(held):
        raise DataError(f"'{name}' claims more numbers than the {len(held)} that are stored.")
    steps = [kind.itemsize * step for step in tensor.stride]
    view = np.lib.stride_tricks.as_strided(held[tensor.offset :], tensor.size, steps)
    return np.array(view)

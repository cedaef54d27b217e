"""Files of tensors as PyTorch writes them, without it."""

import io
import pickle
import sys
import zipfile
from collections import OrderedDict
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest import mock

import numpy as np


class Stored:
    """An array that is written as PyTorch writes tensors; `kind` names its storage."""

    def __init__(self, values: np.ndarray, kind: str, **changes: Any) -> None:
        self.values, self.kind, self.changes = values, kind, changes


def write_torch(file: Path, content: Any, **extra: bytes) -> Path:
    """Write what `torch.save` writes; of bytes, these as the pickle."""
    torch, utils, storages = ModuleType("torch"), ModuleType("torch._utils"), {}

    def _rebuild_tensor_v2(*_: Any) -> None:
        raise AssertionError("a pickle was executed")

    _rebuild_tensor_v2.__module__ = "torch._utils"
    _rebuild_tensor_v2.__qualname__ = "_rebuild_tensor_v2"
    utils._rebuild_tensor_v2 = _rebuild_tensor_v2

    class Key:
        def __init__(self, kind: str, values: np.ndarray) -> None:
            self.kind, self.values = kind, values

    class Pickler(pickle.Pickler):
        def persistent_id(self, it: Any) -> Any:
            if not isinstance(it, Key):
                return None
            storages[str(len(storages))] = it.values.tobytes(order="A")
            kind = type(it.kind, (), {"__module__": "torch"})
            setattr(torch, it.kind, kind)
            return "storage", kind, str(len(storages) - 1), "cpu", it.values.size

        def reducer_override(self, it: Any) -> Any:
            if not isinstance(it, Stored):
                return NotImplemented
            steps = tuple(s // it.values.itemsize for s in it.values.strides)
            size = it.changes.get("size", it.values.shape)
            offset = it.changes.get("offset", 0)
            key = Key(it.kind, it.values)
            return _rebuild_tensor_v2, (key, offset, size, steps, False, OrderedDict())

    if isinstance(content, bytes):
        pickled = content
    else:
        with mock.patch.dict(sys.modules, {"torch": torch, "torch._utils": utils}):
            Pickler(out := io.BytesIO(), protocol=2).dump(content)
        pickled = out.getvalue()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("chirp/data.pkl", pickled)
        for name, raw in {**{f"data/{k}": raw for k, raw in storages.items()}, **extra}.items():
            archive.writestr(f"chirp/{name}", raw)
    return file

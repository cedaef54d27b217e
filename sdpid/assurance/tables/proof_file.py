"""Answers to the question of a table, as the files that the stand-alone checker reads."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any, cast

from sdpid import __version__
from sdpid._common.files import atomic_write_text
from sdpid.errors import CertificateError
from sdpid.verifier.reading import MalformedError
from sdpid.verifier.tables import Answer, answer_dict, answer_of


@dataclass(frozen=True)
class TableFile:
    """The file that a table was read from: its name, and the SHA-256 of its bytes."""

    name: str
    sha256: str

    @classmethod
    def of(cls, path: str | os.PathLike[str], content: bytes) -> TableFile:
        """Return the identity of a file with this content."""
        return cls(Path(path).name, sha256(content).hexdigest())


class Stored:
    """An answer that can be written to a file."""

    def to_dict(self) -> dict[str, Any]:
        """Return the file's content: the whole question and the answer, numbers as text.

        Raises
        ------
        CertificateError
            When a number has more digits than the checker reads.
        """
        data = answer_dict(cast(Answer, self), f"sdpid {__version__}")
        try:
            answer_of(data)
        except MalformedError as cause:
            raise CertificateError(
                f"the proof cannot be written: {cause}; give values with fewer digits."
            ) from None
        return data

    def to_json(self, path: str | os.PathLike[str]) -> None:
        """Write the file, whole or not at all, for ``sdpid verify`` to check."""
        atomic_write_text(path, json.dumps(self.to_dict(), indent=1) + "\n")

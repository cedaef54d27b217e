"""What a check found: what is proven, what is not, and what was not checked."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Result:
    """Sentences on one file, or on several.

    Attributes
    ----------
    statements : tuple of str
        What is proven.
    problems : tuple of str
        What is claimed and does not hold, each by its name.
    unchecked : tuple of str
        What a reader may take for proven and was not checked here.
    """

    KINDS = ("statements", "problems", "unchecked")

    statements: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()
    unchecked: tuple[str, ...] = ()

    def __add__(self, other: Result) -> Result:
        """Return the sentences of both."""
        return Result(*(getattr(self, kind) + getattr(other, kind) for kind in self.KINDS))

    @property
    def passed(self) -> bool:
        """Whether everything that is claimed holds."""
        return not self.problems

    @property
    def lines(self) -> tuple[str, ...]:
        """The sentences, and the verdict last."""
        return (
            *self.statements,
            *(f"not checked: {each}" for each in self.unchecked),
            *(f"NOT PROVEN: {each}" for each in self.problems),
            self.verdict,
        )

    @property
    def verdict(self) -> str:
        """Whether everything that is claimed holds, in a word."""
        if not self.passed:
            return "NOT PROVEN."
        return "PROVEN, but for what was not checked." if self.unchecked else "PROVEN."

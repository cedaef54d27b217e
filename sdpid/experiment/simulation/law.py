"""What a known law makes of a log: what the drives were told, and the efforts that follow."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.simulation.controllers import PD

# Commands are steps that are held where this share of the rows in motion repeat the one before.
_HELD = 0.3

# Without a limit none is reached, N·m (N).
_NO_LIMIT = np.inf


@dataclass(frozen=True, kw_only=True, eq=False)
class Told:
    """What the drives of n joints were told at N time stamps.

    Attributes
    ----------
    command : ndarray, shape (N, n)
        Commanded positions, rad (m).
    feedforward : ndarray, shape (N, n)
        Efforts that are added to those of the law, N·m (N).
    limit : ndarray, shape (n,)
        Largest effort, N·m (N); infinite without any.
    held : bool
        Whether commands are held until the next, or joined by lines.
    note : str
        How commands were understood, in words.
    """

    command: Array
    feedforward: Array
    limit: Array
    held: bool
    note: str

    @classmethod
    def of(cls, log: Recording, law: PD) -> Told:
        """Take what a recording says of the commands.

        Raises
        ------
        DataError
            When it has no commanded positions.
        """
        if log.reference is None:
            raise DataError(
                "law: the log has no commanded positions; name them with "
                "columns={'reference': ...} (--column reference=NAME)."
            )
        command = np.array(log.reference)
        moves = np.any(np.diff(command, axis=0) != 0.0, axis=1)
        at = np.flatnonzero(moves)
        held, note = True, "commands are constant"
        if len(at):
            inside = moves[at[0] : at[-1] + 1]
            held = 1.0 - float(inside.mean()) > _HELD
            every = (log.time[1:][at[-1]] - log.time[1:][at[0]]) / max(len(at) - 1, 1)
            note = (
                f"commands are taken as steps that are held, one in {1e3 * every:.3g} ms"
                if held
                else f"commands change at every row ({1e3 * every:.3g} ms) and are joined by lines"
            )
        added = np.zeros_like(command) if log.feedforward is None else np.array(log.feedforward)
        if log.feedforward is not None:
            note += "; the log's feed-forward efforts are added to the law's"
        limit = np.full(log.n, _NO_LIMIT) if law.limit is None else np.array(law.limit)
        return cls(command=command, feedforward=added, limit=limit, held=held, note=note)

    def at(self, time: Array, delay: float) -> tuple[Array, Array]:
        """Return commands and added efforts (N, n) that act at the time stamps (N,)."""
        when = time - delay
        if self.held:
            row = np.clip(np.searchsorted(time, when + 1e-9, side="right") - 1, 0, len(time) - 1)
            return self.command[row], self.feedforward[row]
        columns = range(self.command.shape[1])
        return tuple(  # type: ignore[return-value]
            np.stack([np.interp(when, time, each[:, j]) for j in columns], axis=1)
            for each in (self.command, self.feedforward)
        )


def with_efforts_of_law(log: Recording, law: PD, delay: float) -> Recording:
    """Return a recording whose efforts are those of a law, at commands of a delay before.

    Parameters
    ----------
    log : Recording
        With commanded positions.
    law : PD
        With one number a joint.
    delay : float
        Time from a command to its effort, s.

    Raises
    ------
    DataError
        When it has no commanded positions.
    """
    told = Told.of(log, law)
    command, added = told.at(np.array(log.time), delay)
    position = np.array(log.position)
    velocity = log.velocity
    if velocity is None:
        velocity = np.gradient(position, np.array(log.time), axis=0)
    gains = law.gains
    effort = gains.proportional * (command - position) - gains.derivative * velocity + added
    return replace(log, effort=np.clip(effort, -told.limit, told.limit), currents=False, gains=None)

"""`Samples`: joint states and efforts, ready for a regression."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np

from sdpid._common.arrays import Array, Mask, frozen_view, is_number, real_array
from sdpid._common.tables import Table
from sdpid.errors import DataError
from sdpid.experiment.drive_gains.gains import DriveGains
from sdpid.experiment.processing.contact_samples import ASYMMETRY, TRANSMITS, ContactSamples
from sdpid.experiment.processing.filters import ZeroPhaseFilter
from sdpid.experiment.recording.floating import EACH_JOINT, Sampled, samples
from sdpid.experiment.recording.recording import checked_names

# Neighbors that `every` keeps together: the memory of the filter is some 80 samples on either side
# at the default decimation, so that filtering a run costs less than twice its own number.
_RUN = 256


# Results that are kept: those of the terms of a model, with room for those tried beside them.
_KEPT = 12


@dataclass(frozen=True, kw_only=True, eq=False)
class WideVelocity:
    """Velocities of one piece of a recording, at more samples and of wider band than those kept.

    Friction is steep in the velocity, and its effort has passed a filter. What stands in the
    filtered efforts is the filtered friction, not friction at the filtered velocity.

    Attributes
    ----------
    velocity : (M, n) ndarray
        In rad/s, with neighbors on either side of the kept samples.
    step : float
        Distance of two samples, in s.
    low_pass : ZeroPhaseFilter
        The filter of the efforts, for this step.
    first, stride, count : int
        The kept samples are ``first + stride·k`` for k below count.
    """

    velocity: Array
    step: float
    low_pass: ZeroPhaseFilter
    first: int
    stride: int
    count: int
    _found: dict[Hashable, Array] = field(default_factory=dict, repr=False, init=False)

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields without the results kept."""
        return {**self.__dict__, "_found": {}}

    def part(self, start: int, stop: int) -> WideVelocity:
        """Return that of neighboring kept samples, from `start` up to `stop`."""
        if stop - start == self.count:
            return self
        lead = self.low_pass.lead
        low = max(0, self.first + self.stride * start - lead)
        high = self.first + self.stride * (stop - 1) + lead + 1
        return replace(
            self,
            velocity=self.velocity[low:high],
            first=self.first + self.stride * start - low,
            count=stop - start,
        )


def filtered(
    wides: Sequence[WideVelocity],
    function: Callable[[Array, Array], Array],
    key: Hashable | None = None,
) -> list[Array]:
    """Return values (count, ...) of a function of each piece's velocity, filtered.

    Parameters
    ----------
    wides : sequence of WideVelocity
        The pieces; those of one filter and length pass it side by side.
    function : callable
        Of velocities and accelerations (M, n), to values (M, ...).
    key : hashable, optional
        Identifies the function: its results are kept for the next call.
    """
    alike = defaultdict(list)
    for wide in wides:
        if key not in wide._found:
            alike[wide.low_pass, len(wide.velocity)].append(wide)
    for (passed, length), own in alike.items():
        rates = [np.gradient(wide.velocity, wide.step, axis=0) for wide in own]
        values = np.stack(list(map(function, [wide.velocity for wide in own], rates)), axis=1)
        smooth = passed.apply(values.reshape(length, -1)).reshape(values.shape)
        for i, wide in enumerate(own):
            kept = smooth[wide.first :: wide.stride, i][: wide.count]
            wide._found[key] = frozen_view(np.ascontiguousarray(kept))
    found = [wide._found[key] for wide in wides]
    for wide in wides:
        wide._found.pop(None, None)
        while len(wide._found) > _KEPT:
            del wide._found[next(iter(wide._found))]
    return found


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Samples(Sampled):
    """States and efforts, sample by sample, ready for a regression.

    Parameters
    ----------
    effort : (K, n) array_like
        In N·m.
    position : (K, n) or (K, nq) array_like
        Joint positions in rad; with a free flyer the configuration, one column more than n.
    velocity, acceleration : (K, n) array_like
        In rad/s and rad/s².
    time : (K,) array_like, optional
        In s.
    covariance : (n, n) or (K, n, n) array_like, optional
        Covariance of the effort in (N·m)², one for all samples or one a sample. From periodic
        records it is that of a single period, the paper's (11); the mean over `periods` periods
        has ``covariance / periods``.
    mask : (K, n) array_like of bool, optional
        True where the row (sample k, joint j) is to be used. None uses all. A joint may have no
        row at all: the six efforts of a floating base are not measured.
    joint_names : sequence of str, optional
        One name a column of `effort`.
    periods : int, optional
        Number of periods that were averaged.
    block : int, optional
        Number of samples in a block clearly longer than the memory of the filter. Blocks, not
        samples, are the independent units of standard errors.
    notes : sequence of str, optional
        What was done in processing, and what was noticed.
    effort_periods : (P, K, n) array_like, optional
        Effort of each period before averaging, in N·m.
    starts : sequence of int, optional
        First sample of each piece that was recorded without a break, in rising order from 0.
    wide : sequence of WideVelocity, optional
        One a piece: what friction columns need to pass the filter of the efforts. Without, friction
        is that at `velocity`.
    gains : DriveGains, optional
        The gains that made the efforts of currents, one a column: their errors count.
    contacts : ContactSamples, optional
        Contacts of a robot whose base floats, sample by sample. Its efforts begin with the six of
        the base, which are zero: nothing drives it but contacts.

    Raises
    ------
    DataError
        When shapes disagree, a value is not finite, a covariance cannot be one, or the mask
        leaves no row at all.

    Examples
    --------
    >>> samples
    Samples(1000 samples, 6 joints, 5222 rows used, mean of 2 periods)
    >>> samples.effort.shape, samples.covariance.shape, samples.n_rows
    ((1000, 6), (6, 6), 5222)
    >>> samples.between(0, 500)
    Samples(500 samples, 6 joints, 2609 rows used)

    States of your own, filtered and differentiated elsewhere:

    >>> sdpid.Samples(position=samples.position, velocity=samples.velocity,
    ...               acceleration=samples.acceleration, effort=samples.effort)
    Samples(1000 samples, 6 joints, 6000 rows used)
    """

    effort: Array = samples("effort", "names", what=EACH_JOINT, needed=True)
    position: Array = samples("position", "_coordinates", what=EACH_JOINT, needed=True)
    velocity: Array = samples("velocity", "names", what=EACH_JOINT, needed=True)
    acceleration: Array = samples("acceleration", "names", what=EACH_JOINT, needed=True)
    time: Array | None = samples("time", what="one time for each sample")
    covariance: Array | None = None
    mask: Mask | None = None
    joint_names: tuple[str, ...] | None = None
    periods: int | None = None
    block: int = 1
    notes: tuple[str, ...] = ()
    effort_periods: Array | None = None
    starts: tuple[int, ...] = (0,)
    wide: tuple[WideVelocity, ...] | None = None
    gains: DriveGains | None = None
    contacts: ContactSamples | None = None
    # Efforts by gains that are about to be refused come to any size.
    _most: ClassVar[float] = np.inf

    def __post_init__(self) -> None:
        effort = real_array(self.effort, "effort", ndim=2)
        K, n = effort.shape
        if K == 0 or n == 0:
            raise DataError(f"effort: has shape {effort.shape}, there is nothing to fit.")
        object.__setattr__(self, "effort", effort)
        if self.joint_names is not None:
            object.__setattr__(self, "joint_names", checked_names(self.joint_names, n))
        self._keep_samples(contacts=ContactSamples)
        if self.position.shape[1] < n:
            raise DataError(
                f"position: has shape {self.position.shape}, expected {(K, n)} as effort has (or "
                "more columns with a free flyer)."
            )
        if self.effort_periods is not None:
            self._keep("effort_periods", 3, (self.periods, K, n))
        if self.gains is not None and self.gains.n != n:
            raise DataError(f"gains: are of {self.gains.n} joints, expected {n} to match effort.")
        if self.covariance is not None:
            ndim = 2 if np.ndim(self.covariance) == 2 else 3
            self._check_covariance(self._keep("covariance", ndim, (n, n), (K, n, n)))
        if self.mask is not None:
            mask = np.ascontiguousarray(self.mask)
            if mask.dtype != np.bool_ or mask.shape != (K, n):
                raise DataError(
                    f"mask: has shape {mask.shape} and type {mask.dtype}, expected {(K, n)} and "
                    "bool."
                )
            object.__setattr__(self, "mask", frozen_view(mask))
            if not mask.any():
                raise DataError(
                    f"mask: leaves none of {mask.size} rows, there is nothing to fit; True "
                    "marks a row that is used."
                )
        object.__setattr__(self, "block", _counted("block", self.block))
        if self.periods is not None:
            object.__setattr__(self, "periods", _counted("periods", self.periods))
        object.__setattr__(self, "notes", tuple(self.notes))
        starts = tuple(int(start) for start in self.starts)
        if starts[:1] != (0,) or any(first >= second for first, second in pairwise((*starts, K))):
            raise DataError(
                f"starts: are {self.starts}, expected rising sample numbers from 0, below {K}."
            )
        object.__setattr__(self, "starts", starts)
        if self.wide is not None:
            object.__setattr__(self, "wide", tuple(self.wide))
            sizes, given = [b - a for a, b in pairwise((*starts, K))], [w.count for w in self.wide]
            if sizes != given or any(wide.velocity.shape[1] != n for wide in self.wide):
                raise DataError(
                    f"wide: is for pieces of {given} samples, expected {sizes}, of {n} joints."
                )

    @staticmethod
    def join(pieces: Sequence[Samples]) -> Samples:
        """Put samples of several recordings, or of parts of one, behind each other.

        Parameters
        ----------
        pieces : sequence of Samples
            Of the same joints. Averages over periods cannot be joined: what they average, and
            so their covariance, would differ from sample to sample.

        Returns
        -------
        Samples
            `starts` says where the pieces begin; covariances and masks are kept sample by sample,
            the longest block holds for all, and `notes` name each piece.

        Raises
        ------
        DataError
            When there is nothing to join, or joints, kinds of configuration or covariances do
            not agree.
        """
        pieces = tuple(pieces)
        if len(pieces) == 1:
            return pieces[0]
        if not pieces:
            raise DataError("samples: there are none to join.")
        first = pieces[0]
        for number, piece in enumerate(pieces[1:], 2):
            for name in ("position", "effort"):
                had, has = getattr(first, name).shape[1], getattr(piece, name).shape[1]
                if had != has:
                    raise DataError(
                        f"samples: {name} of piece {number} has {has} columns, that of the first "
                        f"{had}; join recordings of one robot."
                    )
            if piece.joint_names != first.joint_names:
                raise DataError(
                    f"samples: the joints of piece {number} are {', '.join(piece.names)}, those "
                    f"of the first {', '.join(first.names)}; put them in one order."
                )
            _require_same_gains(first.gains, piece.gains, number)
        if any(piece.periods is not None for piece in pieces):
            raise DataError(
                "samples: averages over periods cannot be joined with others; identify from one "
                "periodic recording, or leave its period out."
            )
        covariances = _of_all(
            pieces, "covariance", "a covariance of the effort; give it for all, or for none"
        )
        wides = _of_all(
            pieces,
            "wide",
            "a wide velocity to filter friction columns with; process all of them alike "
            "(Processing.filter_friction)",
        )
        common = all(np.array_equal(each, covariances[0]) for each in covariances)
        if covariances and not (common and covariances[0].ndim == 2):
            shapes = [(piece.n_samples, piece.n, piece.n) for piece in pieces]
            covariances = [np.concatenate(list(map(np.broadcast_to, covariances, shapes)))]
        tables: dict[str, Any] = {
            name: np.concatenate([getattr(piece, name) for piece in pieces])
            for name in first.channels
            if all(name in piece.channels for piece in pieces)
        }
        if any(piece.mask is not None for piece in pieces):
            tables["mask"] = np.concatenate([piece.used for piece in pieces])
        ends = np.cumsum([piece.n_samples for piece in pieces]).tolist()
        rows = [slice(*each) for each in pairwise((0, *ends))]
        shared = [note for note in first.notes if all(note in piece.notes for piece in pieces)]
        single = [
            f"piece {number}: {note}"
            for number, piece in enumerate(pieces, 1)
            for note in piece.notes
            if note not in shared
        ]
        return Samples(
            **tables,
            covariance=covariances[0] if covariances else None,
            joint_names=first.joint_names,
            block=max(piece.block for piece in pieces),
            notes=(*shared, f"{len(pieces)} pieces joined", *single),
            starts=tuple(
                row.start + start
                for row, piece in zip(rows, pieces, strict=True)
                for start in piece.starts
            ),
            wide=tuple(wide for own in wides for wide in own) or None,
            gains=first.gains,
            contacts=ContactSamples.join([piece.contacts for piece in pieces], rows),
        )

    @property
    def parts(self) -> tuple[slice, ...]:
        """The pieces, as slices of the samples."""
        return tuple(slice(a, b) for a, b in pairwise((*self.starts, self.n_samples)))

    @property
    def pieces(self) -> tuple[Samples, ...]:
        """The pieces, each by itself."""
        if len(self.starts) == 1:
            return (self,)
        return tuple(self._picked(i, part) for i, part in enumerate(self.parts))

    def through_filter(
        self, function: Callable[[Array, Array], Array], which: slice, key: Hashable | None = None
    ) -> Array:
        """Return a function of velocity and acceleration as it stands in some efforts.

        Parameters
        ----------
        function : callable
            Of velocities and accelerations (M, n), to values (M, ...).
        which : slice
            The samples, in rising order.
        key : hashable, optional
            Identifies the function: its values are kept for the next call.

        Returns
        -------
        (k, ...) ndarray
        """
        start, stop, step = which.indices(self.n_samples)
        if self.wide is None:
            return function(self.velocity[which], self.acceleration[which])
        parts = self.parts
        seen = [i for i, part in enumerate(parts) if part.start < stop and part.stop > start]
        found = filtered([self.wide[i] for i in seen], function, key)
        whole, first = found[0] if len(found) == 1 else np.concatenate(found), parts[seen[0]].start
        return whole[start - first : stop - first : step]

    def between(self, start: int, stop: int) -> Samples:
        """Return the samples from `start` up to `stop`, with their pieces.

        Raises
        ------
        DataError
            When there are none.
        """
        cut = [slice(max(start, part.start), min(stop, part.stop)) for part in self.parts]
        found = [self._picked(i, each) for i, each in enumerate(cut) if each.start < each.stop]
        if not found:
            raise DataError(f"samples: there are none from {start} to {stop} of {self.n_samples}.")
        return Samples.join(found)

    def thinned(self, most: int) -> Samples:
        """Return about `most` samples (fewer than twice as many), evenly spread over all pieces."""
        return self.every(max(self.n_samples // most, 1))

    def every(self, step: int) -> Samples:
        """Return one sample in `step`, beginning with the first of every piece.

        Where friction columns have to be filtered, it is one run of neighbors in `step`.
        """
        if step == 1:
            return self
        found = []
        for i, part in enumerate(self.parts):
            if self.wide is None:
                found.append(self._picked(i, slice(part.start, part.stop, step)))
                continue
            for start in range(part.start, part.stop, _RUN * step):
                found.append(self._picked(i, slice(start, min(start + _RUN, part.stop))))
        return Samples.join(found)

    def _picked(self, i: int, which: slice) -> Samples:
        """Return some samples of piece i, without `periods` and the single periods' efforts."""
        picked: dict[str, Any] = {name: table[which] for name, table in self.channels.items()}
        if self.covariance is not None and self.covariance.ndim == 3:
            picked["covariance"] = self.covariance[which]
        if self.wide is not None:
            before = self.starts[i]
            picked["wide"] = (self.wide[i].part(which.start - before, which.stop - before),)
        if self.contacts is not None:
            picked["contacts"] = self.contacts.rows(which)
        alone: dict[str, Any] = dict.fromkeys(("mask", "periods", "effort_periods"))
        samples = replace(self, **alone, **picked, notes=(), starts=(0,))
        if self.mask is not None:
            # Unlike a whole, a part may have no row that is used.
            object.__setattr__(samples, "mask", frozen_view(self.mask[which]))
        return samples

    def _words(self) -> list[str]:
        words = [f"{self.n} joints", f"{self.n_rows} rows used"]
        if self.periods is not None:
            words.append(f"mean of {self.periods} periods")
        if len(self.starts) > 1:
            words.append(f"{len(self.starts)} pieces")
        if self.contacts is not None:
            words.append(f"{self.contacts.n} contacts")
        return words

    def _shown(self) -> dict[str, object]:
        facts: dict[str, object] = {
            "samples": self.n_samples,
            "rows used": self.n_rows,
            "pieces": len(self.starts),
        }
        return (
            facts if self.contacts is None else facts | {"contacts": ", ".join(self.contacts.names)}
        )

    def _tables(self) -> tuple[Table, ...]:
        columns = {
            "joint": list(self.names),
            "rows used": np.count_nonzero(self.used, axis=0).tolist(),
            "rms velocity": np.sqrt(np.mean(np.square(self.velocity), axis=0)).tolist(),
            "rms effort": np.sqrt(np.mean(np.square(self.effort), axis=0)).tolist(),
        }
        return (Table.of_columns(columns),)

    @property
    def n(self) -> int:
        """Number of efforts a sample."""
        return int(self.effort.shape[1])

    @property
    def _coordinates(self) -> range:
        return range(np.shape(self.position)[-1])

    @property
    def used(self) -> Mask:
        """Which rows (K, n) are in use: the mask, or all of them."""
        return np.ones(self.effort.shape, dtype=np.bool_) if self.mask is None else self.mask

    @property
    def judged(self) -> Samples:
        """The samples as fits are compared on them: measured contact forces are eliminated.

        Forces explain what a fit misses as far as their stated errors go, so that it would look the
        better the larger these are. They stay measurements where no joint's effort is used, or
        unknown forces take every row.
        """
        contacts = self.contacts
        if contacts is None or not contacts.measured or not self.used[:, 6:].any():
            return self
        taken = contacts.down @ [TRANSMITS[kind] for kind in contacts.kind]
        if np.all(taken >= self.used.sum(axis=1)):
            return self
        return replace(self, contacts=replace(contacts, forces=None, force_covariance=None))

    @property
    def n_rows(self) -> int:
        """Number of rows (sample, joint) in use."""
        return int(self.effort.size if self.mask is None else np.count_nonzero(self.mask))

    @property
    def names(self) -> tuple[str, ...]:
        """Joint names for messages: the given ones, or numbers from 1."""
        if self.joint_names is not None:
            return self.joint_names
        return tuple(str(j + 1) for j in range(self.n))

    def _keep(self, name: str, ndim: int, *shapes: tuple[int | None, ...]) -> Array:
        """Check the array in a field and put it back as a read-only contiguous view."""
        array = np.ascontiguousarray(real_array(getattr(self, name), name, ndim=ndim))
        if array.shape not in shapes:
            raise DataError(
                f"{name}: has shape {array.shape}, expected {' or '.join(map(str, shapes))} to "
                "match effort."
            )
        object.__setattr__(self, name, frozen_view(array))
        return array

    def _check_covariance(self, covariance: Array) -> None:
        """Check symmetry, and what every covariance satisfies entry by entry."""
        scale = float(np.abs(covariance).max())
        gap = float(np.abs(covariance - np.swapaxes(covariance, -1, -2)).max())
        if gap > ASYMMETRY * scale:
            raise DataError(
                f"covariance: is not symmetric; entries differ by {gap:.3g}, the largest is "
                f"{scale:.3g}."
            )
        # Cheap necessary conditions for a positive semidefinite matrix; the eigenvalues are the
        # business of whoever factorizes it.
        variance = np.diagonal(covariance, axis1=-2, axis2=-1)
        if variance.min() < 0.0:
            j = int(np.argwhere(variance < 0.0)[0][-1])
            raise DataError(
                f"covariance: joint {self.names[j]} has a negative variance ({variance.min():.3g})."
            )
        bound = np.sqrt(variance[..., :, None] * variance[..., None, :])
        excess = float((np.abs(covariance) - bound).max())
        if excess > ASYMMETRY * scale:
            raise DataError(
                "covariance: is not positive semidefinite; an entry exceeds the geometric mean of "
                f"its two variances by {excess:.3g}."
            )


def _counted(name: str, value: Any) -> int:
    """Return a whole number of at least one, or raise."""
    whole = is_number(value) and float(value).is_integer()
    if not whole or value < 1:
        raise DataError(f"{name}: is {value}, expected a whole number of at least 1.")
    return int(value)


def _of_all(pieces: Sequence[Samples], name: str, what: str) -> list[Any]:
    """Return what all pieces have in a field, nothing where none has it."""
    given = [each for piece in pieces if (each := getattr(piece, name)) is not None]
    if given and len(given) < len(pieces):
        raise DataError(f"samples: {len(given)} of {len(pieces)} pieces have {what}.")
    return given


def _require_same_gains(first: DriveGains | None, own: DriveGains | None, number: int) -> None:
    """Refuse a piece with other gains than the first: they would make errors of another kind."""
    alike = first is own if first is None or own is None else first.same_errors(own)
    if not alike:
        said = ["none" if gains is None else gains.in_words for gains in (first, own)]
        raise DataError(
            f"gains: those of piece {number} ({said[1]}) are others than those of the first "
            f"({said[0]}); read all recordings that are used together with the same gains."
        )

"""Whether noise in the measured motion biases least squares on a log."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np

from sdpid._common.arrays import require_probability
from sdpid._common.tables import Shown, Table, plain_dict
from sdpid._common.threads import one_thread
from sdpid.errors import IdentifiabilityError, SdpidError
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.instrumental.hausman import Contrast, Hotelling
from sdpid.estimation.instrumental.moments import Columns
from sdpid.estimation.instrumental.second_stage import FirstStage, require_instrumentable
from sdpid.estimation.instrumental.sources import Instruments, source_of, start_model, with_lag
from sdpid.estimation.problem import Problem
from sdpid.experiment.preparation.several import ProcessingOf
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.simulation.law import Controller

# A shift of the predicted efforts below this share of the efforts does not matter: raw logs with
# noisy encoders shift by 9 to 17 %, filtered ones by 0.5 %, masked ones by 0.02 %, and any model
# of a real arm misses more.
SHIFT = 0.01


@dataclass(frozen=True, kw_only=True, repr=False)
class BiasTest(Shown):
    """What instruments say of the bias of least squares.

    Attributes
    ----------
    instruments : str
        What the instruments are.
    joint_names : tuple of str
        The joints.
    shift : float
        By how much the efforts that instruments predict differ from those of least squares, as a
        share of the measured efforts (rms over all rows in use).
    shifts : tuple of float
        The same of each joint; zero where no row is in use.
    p : float or None
        Probability of a test statistic as large as this where nothing biases least squares; None
        where the record is too short for a test.
    statistic : float or None
        F of the test.
    freedom : (int, int) or None
        Its degrees of freedom.
    level : float
        The test rejects below this p.
    limit : float
        Smallest shift that matters.
    weak : tuple of str
        Base parameters for which the instruments are weak.
    note : str or None
        What one should know of the choice of instruments.

    Examples
    --------
    >>> test = sdpid.check_bias(problem, log, instruments="periods")
    >>> test.biased, bool(test.shift < test.limit)
    (False, True)
    >>> print(test.verdict)
    Noise in the motion does not bias least squares: predictions shift by ... % of the effort ...
    """

    instruments: str
    joint_names: tuple[str, ...]
    shift: float
    shifts: tuple[float, ...]
    p: float | None
    statistic: float | None
    freedom: tuple[int, int] | None
    level: float
    limit: float = SHIFT
    weak: tuple[str, ...] = ()
    note: str | None = None

    _facts = ("biased", "shift", "limit", "p", "instruments")

    @property
    def significant(self) -> bool | None:
        """Whether the test rejects that nothing biases least squares; None without a test."""
        return None if self.p is None else self.p < self.level

    @property
    def biased(self) -> bool:
        """Whether predictions shift by more than the limit, and not by chance."""
        return self.shift >= self.limit and self.significant is not False

    @property
    def verdict(self) -> str:
        """One sentence: whether it matters, by how much, and what to do."""
        found = f"predictions shift by {100.0 * self.shift:.2g} % of the effort"
        chance = "too short for a test" if self.p is None else f"p = {self.p:.2g}"
        weak = f"; weak for {len(self.weak)} base parameters" if self.weak else ""
        against = f"({chance}; against {self.instruments}{weak})"
        if self.biased:
            worst = self.joint_names[int(np.argmax(self.shifts))]
            return (
                f"Noise in the motion biases least squares: {found}, most of joint {worst} "
                f"{against}; use sdpid.solve_instrumental, or a lower cut-off."
            )
        if self.shift >= self.limit:
            return (
                f"Noise in the motion is not shown to bias least squares: {found}, by chance "
                f"{against}; record longer to know."
            )
        return (
            f"Noise in the motion does not bias least squares: {found} {against}, below "
            f"{100.0 * self.limit:g} %."
        )

    def _tables(self) -> Iterator[Table]:
        yield Table(("verdict",), ((self.verdict,),))
        yield Table.of_columns({"joint": list(self.joint_names), "shift": list(self.shifts)})

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return plain_dict({**asdict(self), "biased": self.biased, "verdict": self.verdict})


@one_thread
def check_bias(
    problem: Problem | Estimate,
    recording: Any = None,
    *,
    processing: ProcessingOf = None,
    reference: Any = None,
    controller: Controller | Literal["fit"] | None = None,
    instruments: Instruments | Samples | None = None,
    level: float = 0.05,
) -> BiasTest:
    """Test whether noise in the measured motion biases least squares.

    A Durbin-Wu-Hausman test for filtered logs of robots [janot2016]_: whether the errors of least
    squares go with the part of the regressor that instruments do not see, one number a joint, with
    blocks of samples as what is independent. On long logs it finds any difference, so the verdict
    is that of the predicted efforts: how much they shift with instruments.

    Parameters
    ----------
    problem : Problem or Estimate
        Of the measured samples. An estimate saves solving once where a model is simulated.
    recording : Recording or path, or a sequence of these
        What the problem was built of. Not needed with Samples as `instruments`.
    processing, reference, controller, instruments : optional
        As for `solve_instrumental`. With neither of the last two, where what the log holds is a
        weak instrument, a controller is fitted to it and the model simulated.
    level : float, optional
        Probability with which the test may reject where nothing biases.

    Returns
    -------
    BiasTest
        ``.biased``, ``.verdict`` and the numbers.

    Raises
    ------
    DataError
        As for `solve_instrumental`.
    IdentifiabilityError
        When the instruments do not move with the measured motion.

    Examples
    --------
    >>> test = sdpid.check_bias(estimate, log, instruments="periods")
    >>> test
    BiasTest(biased=False, shift=..., p=...)
    >>> test.instruments
    'the motion in the other half of the periods'
    """
    require_probability(level, "check_bias: level")
    given = problem.problem if isinstance(problem, Estimate) else problem
    require_instrumentable(given, "check_bias")

    def tested(controller: Controller | Literal["fit"] | None) -> BiasTest:
        source = source_of(
            given,
            recording,
            purpose="check_bias",
            processing=processing,
            reference=reference,
            controller=controller,
            instruments=instruments,
        )
        model = None
        if source.follows_model:
            known = isinstance(problem, Estimate) and problem.theta is not None
            model = start_model(given, problem if known else None)
        first = source.first_stage(Columns.of(given), model)
        return bias_of(first, source.words, with_lag(source.note, first, source), level)

    if controller is not None or instruments is not None:
        return tested(controller)
    return _best_of(tested)


def _best_of(tested: Callable[[Controller | Literal["fit"] | None], BiasTest]) -> BiasTest:
    """Return the test against what the log holds, else against the model under a fitted controller.

    A robot that lags far behind what is commanded still moves as its model does in its loop.

    Raises
    ------
    IdentifiabilityError
        When all is weak, or no controller can be fitted: with what to give.
    """
    found, weak = None, None
    try:
        found = tested(None)
        if not found.weak:
            return found
    except IdentifiabilityError as error:
        weak = error
    try:
        other = tested("fit")
    except SdpidError as reason:
        missing = f"the model under a fitted controller is no better instrument: {reason}"
        if found is None:
            raise IdentifiabilityError(f"{weak} For now, {missing}") from weak
        return replace(found, note="; ".join(filter(None, (found.note, missing))))
    return other if found is None or len(other.weak) < len(found.weak) else found


def bias_of(first: FirstStage, words: str, note: str | None, level: float) -> BiasTest:
    """Return the test of an instrumental estimate."""
    first.require_strong(words)
    samples = first.columns.rows.samples
    contrast = Contrast.of(first, samples.block)
    test = Hotelling.of(contrast.sums)
    effort = np.where(contrast.effort > 0.0, contrast.effort, 1.0)
    shifts = np.sqrt(contrast.shift / effort)
    total = float(np.sqrt(contrast.shift.sum() / max(contrast.effort.sum(), np.finfo(float).tiny)))
    return BiasTest(
        instruments=words,
        joint_names=samples.names,
        shift=total,
        shifts=tuple(shifts.tolist()),
        p=None if test is None else test.p,
        statistic=None if test is None else test.statistic,
        freedom=None if test is None else test.freedom,
        level=level,
        weak=first.weak,
        note=note,
    )

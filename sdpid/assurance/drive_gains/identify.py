"""Identify drive gains from currents, with a load, a gain, or the description to give the scale."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid._common.threads import one_thread
from sdpid.assurance.drive_gains import checks
from sdpid.assurance.drive_gains.errors import gain_errors
from sdpid.assurance.drive_gains.fit import FoundGains, GainFit
from sdpid.assurance.drive_gains.load import Load
from sdpid.assurance.drive_gains.model import (
    GainModel,
    chosen_terms,
    first_terms,
    gain_processing,
)
from sdpid.assurance.drive_gains.result import (
    CarriedLoad,
    IdentifiedGains,
    basis_in_words,
    notes_on,
)
from sdpid.errors import DataError, ModelError
from sdpid.estimation.effects.kinds import Effects
from sdpid.experiment.drive_gains.gains import DriveGains
from sdpid.experiment.inspection.inspect import kinds_accepted
from sdpid.experiment.preparation.prepare import Logs, ProcessingOf, as_pieces, samples_of
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.readers.read import read_recording
from sdpid.experiment.recording.joints import match_joints
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.inertia import transform
from sdpid.robot.model.arms import require_fixed_robot, require_open_chain
from sdpid.robot.model.geometry import carrying_frame
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel

# Starts of the search beside the rough gains, and the spread of their logarithms.
_STARTS, _SPREAD = 12, 0.7
# Rounds in which weights and friction of the load follow the fit: after four the gains of a UR10e
# move by less than 0.1 %.
_ROUNDS = 4
# Costs of one minimum, relative.
_SAME = 1e-6


@one_thread
def identify_drive_gains(
    robot: RobotModel | str | os.PathLike[str],
    without_load: Logs,
    with_load: Logs | None = None,
    *,
    load: float | Load | Sequence[float | Load] | None = None,
    link: str | None = None,
    frame: str | None = None,
    known: Mapping[str, float] | None = None,
    description_error: float | None = None,
    friction: Iterable[str | FrictionTerm] | None = None,
    effects: Effects = "auto",
    shared: Iterable[str] = ("rotor_inertia", "load"),
    processing: ProcessingOf = None,
    consistent: bool = True,
    starts: int = _STARTS,
    accept: str | Iterable[str] = (),
) -> IdentifiedGains:
    """Identify drive gains, N·m/A, from motor currents.

    The gains with which one arm of links that can exist, without and with the load, explains all
    currents best; errors are those of the currents. Something must give the scale: a load of
    known mass, the gain of a joint, or the described links with a stated error.
    See docs/guides/gains.md.

    Parameters
    ----------
    robot : RobotModel, name or path
        The arm without the load.
    without_load : Recording or path, or a sequence of these
        Currents in A without the load.
    with_load : Recording or path, or a sequence of these, optional
        Currents in A with it. Where and how it is mounted may differ between recordings.
    load : float, Load or a sequence of these, optional
        Mass in kg, or what more is known of the load; one for all recordings with load, or one
        each.
    link : str, optional
        Which link carries it; by default the last one.
    frame : str, optional
        A frame fixed to that link, in which the load's center of mass is given; by default the
        joint frame of the link.
    known : mapping of str to float, optional
        Gains of joints that are known, N·m/A.
    description_error : float, optional
        Relative standard deviation that the described links are granted, such as 0.1. By default
        nothing is taken from them.
    friction : iterable, optional
        Friction terms; by default Coulomb and viscous friction with a smooth sign, a sigmoid and
        an offset.
    effects : {"auto", "none"}, str or iterable of str, optional
        Effects beside them, as for `identify`.
    shared : iterable of str, optional
        Names of terms that are the same in all recordings; of others every recording has its own
        parameters, for friction changes with temperature.
    processing : Processing or mapping, optional
        By default as `identify` chooses it, with slow motion masked.
    consistent : bool, optional
        Whether links and loads must be bodies that can exist.
    starts : int, optional
        From how many further, random gains the search starts.
    accept : str or iterable of str, optional
        As for `identify`: kinds of findings that do not refuse a recording.

    Returns
    -------
    IdentifiedGains
        Gains with their covariance, and what they were found from.

    Raises
    ------
    DataError
        When recordings or numbers make no sense: torques in place of currents, a load that is
        heavier than the arm can hold, recordings that are not of one arm.
    IdentifiabilityError
        When the recordings do not show a gain; it says which, and what they do show.
    ModelError
        When the robot has no such link or frame, no description to believe, or a floating base.

    Examples
    --------
    >>> theta = estimate.theta.copy()
    >>> theta[50:60] += [5.0, 0.0, 0.0, 1.0, 0.25, 0.0, 0.25, 0.0, 0.0, 0.05]  # 5 kg at link_6
    >>> loaded = sdpid.simulate(robot, motion, theta=theta, exact=True, seed=1)
    >>> currents = [
    ...     sdpid.Recording(time=each.time, position=each.position, effort=each.effort / 10.0,
    ...                     joint_names=robot.joint_names, currents=True)
    ...     for each in (log, loaded)
    ... ]
    >>> found = sdpid.identify_drive_gains(robot, *currents, load=5.0, effects="none")
    >>> bool(np.all(np.abs(found.gains.gains / 10.0 - 1.0) < 0.05))
    True
    """
    arm = robot if isinstance(robot, RobotModel) else load_robot(robot)
    require_fixed_robot(arm, "gains")
    kinds = kinds_accepted(accept)
    bare = _recordings(without_load)
    loaded = () if with_load is None else _recordings(with_load)
    if not bare:
        raise DataError("without_load: there are no recordings; give at least one.")
    checks.require_currents(bare, loaded)
    loads = _loads(load, len(loaded))
    held = _held(arm, known or {})
    _check_numbers(arm, description_error, starts)
    require_open_chain(arm, "gains")
    logs = [match_joints(arm, log) for log in (*bare, *loaded)]
    checks.require_every_current(logs)
    chosen, why = gain_processing(logs, processing)
    samples = tuple(samples_of(arm, replace(log, currents=False), chosen) for log in logs)
    unloaded = Samples.join(samples[: len(bare)])
    rough = checks.rough_gains(arm, unloaded, kinds)
    findings = checks.looked_at(arm, logs[: len(bare)], logs[len(bare) :], rough, kinds)
    number, rotation, translation, frame_name = carrying_frame(arm, link, frame, what="gains")
    placed = np.zeros((10 * arm.n_links, 10))
    placed[10 * number :][:10] = transform(np.eye(10), rotation, translation).T
    for each, own in zip(loads, samples[len(bare) :], strict=True):
        checks.require_bearable(arm, each, own, placed)
    rough = np.log(np.where(held > 0.0, held, rough))
    model = GainModel(
        robot=arm,
        terms=first_terms(arm),
        alike=tuple(shared),
        samples=samples,
        loads=loads,
        placed=placed,
        free=held == 0.0,
        description_error=description_error,
    )
    # Effects are told by what links that can exist explain, so nearly right gains are needed.
    near = _settled(model, rough, 2)[1].logs
    terms, told = chosen_terms(arm, unloaded, logs[0], np.exp(near), friction, effects)
    model = replace(model, terms=terms)
    fit, found = _settled(model, near, _ROUNDS)
    checks.require_one_arm(fit, found)
    best, agreed = _best(fit, found, near, starts)
    final = fit.consistent(best) if consistent else best
    covariance, freedom, blocks = gain_errors(fit, best)
    status = "optimal" if final.settled else "the search among bodies that can exist did not settle"
    if not best.settled:
        status = "the search did not settle"
    gains, unconstrained = np.exp(final.logs), np.exp(best.logs)
    rmse = np.sqrt(fit.mean_squares(final))
    notes = tuple(notes_on(model, gains, unconstrained, covariance, blocks))
    result = DriveGains(
        joint_names=arm.joint_names,
        gains=gains,
        covariance=covariance * np.outer(gains, gains),
        freedom=freedom,
        basis=basis_in_words(loads, known, description_error),
        sources={
            log.source.name: log.source.sha256 for log in (*bare, *loaded) if log.source is not None
        },
        notes=notes,
    )
    return IdentifiedGains(
        gains=result,
        loads=tuple(
            CarriedLoad(
                mass=each.mass,
                com=frozen(theta[1:4] / theta[0]),
                theta=frozen(theta),
                link=arm.link_names[number],
                frame=frame_name,
            )
            for each, theta in zip(loads, model.carried(model.bodies(final.unknown)), strict=True)
        ),
        rmse=frozen(rmse),
        share=frozen(rmse / np.where(model.spread > 0.0, model.spread, 1.0)),
        unconstrained=frozen(unconstrained),
        starts=starts + 1,
        agreed=agreed,
        effects=told,
        status=status,
        notes=notes if why is None else (why, *notes),
        findings=findings,
    )


def _settled(model: GainModel, start: Array, rounds: int) -> tuple[GainFit, FoundGains]:
    """Search from rough gains; then weights and friction of the load follow, some rounds."""
    fit = GainFit.of(model, [model.robot.prior] * len(model.samples))
    checks.require_shown(fit, start)
    found = fit.search(start)
    for _ in range(rounds):
        near = fit.consistent(found, hold=True)
        links = model.loaded_links(model.bodies(near.unknown))
        fit = replace(GainFit.of(model, links), errors=fit.mean_squares(found))
        found = fit.search(found.logs)
    return fit, found


def _best(fit: GainFit, found: FoundGains, near: Array, starts: int) -> tuple[FoundGains, int]:
    """Return the least cost that the search comes to from random starts too, and how many do."""
    rng = np.random.default_rng(0)
    every = [found]
    for _ in range(starts):
        every.append(fit.search(near - fit.model.free * rng.normal(0.0, _SPREAD, len(near))))
    enough = min(each.cost for each in every) * (1.0 + _SAME)
    same = [each for each in every if each.cost <= enough]
    return (found if found.cost <= enough else min(every, key=lambda each: each.cost)), len(same)


def _recordings(given: Logs) -> tuple[Recording, ...]:
    """Return recordings of currents, read as amperes."""
    each: Any = as_pieces(given)
    return tuple(
        log if isinstance(log, Recording) else read_recording(log, currents=True) for log in each
    )


def _loads(given: float | Load | Sequence[float | Load] | None, count: int) -> tuple[Load, ...]:
    """Return one load a recording with load."""
    if not count:
        if given is not None:
            raise DataError("load: there is no recording with load; give it (with_load=, --with).")
        return ()
    if given is None:
        raise DataError("load: say the mass of the load in kg (load=, --load).")
    one = isinstance(given, Load | int | float | np.number)
    each: Any = [given] if one else list(given)  # type: ignore[arg-type]
    loads = [load if isinstance(load, Load) else Load(mass=load) for load in each]
    if len(loads) == 1:
        loads *= count
    if len(loads) != count:
        raise DataError(
            f"load: there are {len(loads)} for {count} recordings with load; give one for all, or "
            "one each."
        )
    return tuple(loads)


def _held(robot: RobotModel, known: Mapping[str, float]) -> Array:
    """Return the known gains (n,), zero where there is none."""
    for name, value in known.items():
        if name not in robot.joint_names:
            raise DataError(
                f"known: '{robot.name}' has no joint '{name}'; it has "
                f"{', '.join(robot.joint_names)}."
            )
        if not (np.isfinite(value) and value > 0.0):
            raise DataError(f"known: the gain of {name} is {value}; give a positive one, N·m/A.")
    return np.array([float(known.get(name, 0.0)) for name in robot.joint_names])


def _check_numbers(robot: RobotModel, description_error: float | None, starts: int) -> None:
    if description_error is not None and not np.all(robot.prior[:, 0] > 0.0):
        raise ModelError(
            f"description_error: the description of '{robot.name}' gives links no mass; give a "
            "load of known mass, or a known gain."
        )
    if description_error is not None and not 0.0 < description_error < 10.0:
        raise DataError(
            f"description_error is {description_error!r:.80}; give a relative standard deviation, "
            "such as 0.1."
        )
    if isinstance(starts, bool) or not isinstance(starts, int) or starts < 0:
        raise DataError(f"starts is {starts!r:.80}; give a number of at least 0.")

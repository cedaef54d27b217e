"""Friction terms that are used by default, of the kind of the recording."""

from __future__ import annotations

from collections.abc import Iterable

from sdpid.experiment.recording.recording import Recording
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.friction.terms import Coulomb, SigmoidFriction

# Among friction terms: those that are used by default.
DEFAULT = "default"

# Half-width of the smooth sign of real friction, rad/s. Its columns pass the filter of the efforts,
# so it need not be as wide as the filter smears; wider friction is the sigmoid's business.
SMOOTH = 0.005


def default_friction(log: Recording) -> tuple[str | FrictionTerm, ...]:
    """Return the friction terms that are used by default.

    Records with periods are masked around reversals, where the exact sign is right. Others get
    a smooth sign, a sigmoid whose speeds are fitted joint by joint, and an offset for the
    sensors' zero errors. The same terms serve torque sensors and motor currents: on five
    real robots none predicted worse for the sigmoid, and the others choose it whichever is left
    out (docs/evidence/real_robots.md). Rotor inertia and couplings are effects, which `identify`
    adds where the training data show them (docs/guides/effects.md). Legs are driven through small
    gears whose rotors weigh as much as their links: recordings with a base get rotor inertia, and
    one smooth sign whose width is fitted.
    """
    if log.period is not None:
        return ("coulomb", "viscous")
    if log.base is not None:
        return (SigmoidFriction(), "viscous", "rotor_inertia")
    return (Coulomb(width=SMOOTH), SigmoidFriction(), "viscous", "offset")


def friction_of(
    log: Recording, given: Iterable[str | FrictionTerm] | None
) -> tuple[str | FrictionTerm, ...]:
    """Return the friction terms to use: given ones, `DEFAULT` among them standing for its terms."""
    terms: list[str | FrictionTerm] = []
    for each in (DEFAULT,) if given is None else given:
        terms += default_friction(log) if isinstance(each, str) and each == DEFAULT else [each]
    return tuple(terms)

"""Turn currents into torques by drive gains."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from sdpid._common.arrays import real_array
from sdpid.errors import DataError
from sdpid.experiment.drive_gains.gains import DriveGains
from sdpid.experiment.recording.joints import ways_to_match
from sdpid.experiment.recording.recording import Recording, with_source
from sdpid.experiment.recording.stored import transformed

# What whoever has currents and no gains can do.
IN_AMPERES = (
    "efforts are currents in A, which need gains: let `sdpid gains` (sdpid.identify_drive_gains) "
    "estimate them from runs without and with a load of known mass, and give its file (--gains "
    "gains.toml, gains=); or give known ones, torque constant times gear ratio of each joint in "
    "N.m/A (--effort-scale, effort_scale=)."
)


# What whoever has no efforts can do.
NO_EFFORT = (
    "no effort was measured; give the law that turned commanded positions into efforts (--law pd "
    "--kp 20 --kd 1.5; law=sdpid.controllers.PD(kp=20.0, kd=1.5) of sdpid.identify), or name the "
    "efforts with --column effort=NAME."
)


def require_torques(log: Recording, name: str | None = None) -> None:
    """Refuse a recording of currents, or without efforts, where torques are needed.

    Parameters
    ----------
    log : Recording
        The recording.
    name : str, optional
        What it is called, such as ``"payload, log"``.

    Raises
    ------
    DataError
        Saying how to get gains, or what to do without efforts.
    """
    require_measured(log, name)
    if log.currents:
        raise DataError(IN_AMPERES if name is None else f"{name}: {IN_AMPERES}")


def require_measured(log: Recording, name: str | None = None) -> None:
    """Refuse a recording without efforts; as `require_torques`."""
    if "effort" not in log.channels:
        raise DataError(NO_EFFORT if name is None else f"{name}: {NO_EFFORT}")


def scaled(log: Recording, gains: Any) -> Recording:
    """Return a recording with currents turned into torques.

    Parameters
    ----------
    log : Recording
        With currents in A as its efforts.
    gains : DriveGains or (n,) array_like
        N·m/A. Those of `DriveGains` are found by the joints' names, and their errors count in all
        that follows; numbers are taken as exact, in the order of the columns.

    Raises
    ------
    DataError
        When its currents were turned into torques by gains before, or a joint has no gain.
    """
    if log.gains is not None:
        raise DataError(
            "gains: efforts of this recording were turned into torques by gains already; give "
            "gains once, where the log is read or here."
        )
    found = gains_for(log, gains)
    result = replace(
        log,
        effort=transformed(log.effort, lambda values: values * found.gains),
        currents=False,
        gains=found,
    )
    if log.source is None:
        return result
    # What reads the file again to the same numbers.
    options = {key: value for key, value in log.source.options.items() if key != "currents"}
    return with_source(result, replace(log.source, options={**options, "gains": found.to_dict()}))


def gains_for(log: Recording, gains: Any) -> DriveGains:
    """Return gains in the order of a recording's columns, by the names of its joints.

    As for a robot's joints, names may differ by one common prefix and suffix.

    Raises
    ------
    DataError
        When there are no gains for its joints.
    """
    if not isinstance(gains, DriveGains):
        values = real_array(gains, "gains", ndim=1)
        if values.shape != (log.n,):
            raise DataError(f"gains: are {values.size}, expected {log.n}: one a joint.")
        return DriveGains(joint_names=log.names, gains=values, basis="given without errors")
    if log.joint_names is None or log.joint_names == gains.joint_names:
        if gains.n != log.n:
            raise DataError(
                f"gains: are of {gains.n} joints ({', '.join(gains.joint_names)}), the log has "
                f"{log.n} columns without names; give joint_names (--joint-names)."
            )
        return gains.renamed(log.names)
    ways = ways_to_match(log.joint_names, gains.joint_names)
    own = ways.pop() if len(ways) == 1 else log.joint_names
    return gains.of_joints(own).renamed(log.joint_names)

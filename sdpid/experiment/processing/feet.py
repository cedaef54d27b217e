"""Contacts of a recording as its filtered efforts know them: widened flags, filtered forces."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.errors import DataError
from sdpid.experiment.processing.contact_samples import ContactSamples
from sdpid.experiment.processing.pipeline import Pipeline, near
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.recording.floating import Contacts
from sdpid.experiment.recording.gaps import Grid


def feet_of(
    contacts: Contacts, pipeline: Pipeline, processing: Processing
) -> tuple[ContactSamples, Mask, list[str]]:
    """Return the contacts at the kept samples.

    A filtered effort holds the contact forces of all samples that the filter sees. A foot that was
    down at one of them counts as down.

    Parameters
    ----------
    contacts : Contacts
        As they were recorded.
    pipeline : Pipeline
        Grid, filter and window.
    processing : Processing
        By how much flags may be late or early, whether samples around landings are clear, and
        whether recorded forces are measurements.

    Returns
    -------
    ContactSamples
        For the rows.
    (K,) ndarray of bool
        Samples away from landings.
    list of str
        What was done, in words.

    Raises
    ------
    DataError
        When forces are to be measurements, and none were recorded.
    """
    step, reach = pipeline.grid.step, pipeline.low_pass.reach
    margin_s, impact_s = processing.contact_margin_s, processing.impact_s
    wrench = _wrenches(contacts)
    on_ground = contacts.closed
    down = _on_grid(on_ground, pipeline.grid)
    wide = near(down, reach + round(margin_s / step))
    kept_down = pipeline.kept(wide)
    filtered = covariance = None
    # What holds a base without a sensor is eliminated beside forces that are measured.
    held = contacts.kind == ("plane",) and bool(on_ground.all())
    if processing.contact_force_std is not None and (wrench is not None or not held):
        if wrench is None:
            raise DataError(
                "contact_force_std: the recording has no contact forces; leave it out, and they "
                "are eliminated, or give contacts.forces or contacts.wrenches."
            )
        filtered = pipeline.kept(pipeline.low_pass.whole(pipeline.whole(wrench)))
        covariance = _covariance(contacts, processing)
    clear: Mask = np.ones(len(kept_down), dtype=np.bool_)
    notes = [_share_note(contacts, pipeline.kept(down), kept_down, reach * step + margin_s)]
    landing = _landings(down)
    beside: Mask = pipeline.kept(near(landing, reach + round((impact_s or 0.0) / step)))[:, 0]
    if impact_s is not None:
        share, count = 100.0 * float(beside.mean()), int(landing.sum())
        of_them = f"within {1e3 * impact_s:.3g} ms and the filter's memory of {count} landings"
        if beside.mean() > 1.0 - processing.kept_share:
            notes.append(
                f"samples {of_them} are not left out: they are {share:.3g} % of all, and less than "
                f"{100.0 * processing.kept_share:.3g} % would stay"
            )
        else:
            clear = ~beside
            if count:
                notes.append(f"{share:.3g} % of the samples left out, {of_them}")
    if wrench is not None:
        said = "used as measurements"
        if filtered is None:
            said = "not used: those of closed contacts are eliminated (contact_force_std)"
        notes.append(f"recorded contact forces are {said}")
    samples = ContactSamples(
        frames=contacts.frames,
        kind=contacts.kind,
        offset=contacts.offset,
        down=kept_down,
        forces=filtered,
        force_covariance=covariance,
        widened_s=reach * step + margin_s,
        landed=beside,
    )
    return samples, clear, notes


def carried(contacts: Contacts, reach: int) -> Contacts:
    """Return contacts that carry nothing while they are open, but for `reach` samples.

    The sensor of a foot in the air shows its offset, which a filter would take to the ground.
    """
    acting = near(contacts.closed, reach)[:, :, None]
    felt: dict[str, Any] = {k: v * acting for k, v in contacts.channels.items() if k != "down"}
    return replace(contacts, **felt)


def landing_share(contacts: Contacts, reach: int) -> float:
    """Return the share of a recording's samples that are at most `reach` ones from a landing."""
    return float(near(_landings(contacts.closed), reach).mean())


def _landings(down: Mask) -> Mask:
    """Return at which samples a contact closes, (N, 1)."""
    found = np.zeros((len(down), 1), dtype=np.bool_)
    found[1:, 0] = (down[1:] & ~down[:-1]).any(axis=1)
    return found


def _on_grid(flags: Mask, grid: Grid) -> Mask:
    """Return flags (N, c) at all grid points: set where that of either neighbor is set."""
    if grid.stamps is None:
        return flags[: grid.count]
    wanted = grid.origin + grid.step * np.arange(grid.count)
    after = np.clip(np.searchsorted(grid.stamps, wanted), 1, len(grid.stamps) - 1)
    either: Mask = flags[after - 1] | flags[after]
    return either


def _wrenches(contacts: Contacts) -> Array | None:
    """Return forces and moments at the contact points (N, c, 6), in the world's axes."""
    if contacts.wrenches is not None:
        wrench = np.array(contacts.wrenches)
        wrench[..., 3:] -= np.cross(np.asarray(contacts.offset), wrench[..., :3])
        points = np.array([kind == "point" for kind in contacts.kind])
        wrench[:, points, 3:] = 0.0
        return wrench
    if contacts.forces is None:
        return None
    return np.concatenate([contacts.forces, np.zeros_like(contacts.forces)], axis=-1)


def _covariance(contacts: Contacts, processing: Processing) -> Array:
    """Return the covariance (6, 6) of recorded forces and moments, infinite where there is none."""
    moment = processing.contact_moment_std if contacts.wrenches is not None else None
    variance = np.full(6, np.inf if moment is None else moment**2)
    variance[:3] = (processing.contact_force_std or 0.0) ** 2
    return np.diag(variance)


def _share_note(contacts: Contacts, raw: Mask, wide: Mask, memory_s: float) -> str:
    shares = ", ".join(
        f"{name} {100.0 * a:.3g} → {100.0 * b:.3g} %"
        for name, a, b in zip(contacts.frames, raw.mean(axis=0), wide.mean(axis=0), strict=True)
    )
    return (
        f"a contact counts as closed within {1e3 * memory_s:.3g} ms of a closed one, which is as "
        f"far as the filter sees; share of time: {shares}"
    )

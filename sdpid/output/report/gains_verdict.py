"""What the verdict says of gains that made efforts of currents."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sdpid.errors import SdpidError
from sdpid.estimation.gain_errors import gain_errors
from sdpid.estimation.posterior import Posterior
from sdpid.output.report.finding import Finding, listed
from sdpid.output.report.judged import Judged

# A parameter is as good as its gains where more than half of its variance is theirs: no longer
# record halves it.
MOSTLY = 0.5


def gains_findings(result: Judged) -> Iterator[Finding]:
    """Say what errors of the gains do to the parameters, or that none are counted."""
    errors, rows = gain_errors(result.problem), result.problem.rows
    gains = None if rows is None else rows.samples.gains
    if gains is None:
        return
    if errors is None:
        yield Finding(
            "caution",
            "Efforts were made of currents by gains that are taken as exact: no interval counts "
            "their errors, and a common factor of the gains is one of every mass. 'sdpid gains' "
            "estimates gains with errors.",
        )
        return
    shares = gains.standard_errors / gains.gains
    ends = " to ".join(
        dict.fromkeys(f"{100.0 * share:.2g} %" for share in (shares.min(), shares.max()))
    )
    known = (
        f"Efforts were made of currents by gains that are known to {ends} (one standard error), "
        f"{100.0 * gains.common_factor:.2g} % of it in common, which moves every mass and inertia "
        "alike"
    )
    try:
        found = Posterior.of(result.estimate).share(errors, result.problem.base.matrix)
    except SdpidError:  # no covariance; a verdict must not cost the run
        found = np.zeros(0)
    most = np.argsort(-found)[: int(np.count_nonzero(found > MOSTLY))].tolist()
    if not most:
        yield Finding("good", f"{known}. Intervals count that; no parameter hangs on it mostly.")
        return
    names = result.problem.base.names
    yield Finding(
        "caution",
        f"{known}. It is most of what is not known of {len(most)} of {len(names)} base parameters: "
        f"{listed(names[i] for i in most)}. Better gains sharpen them, a longer record does not.",
    )

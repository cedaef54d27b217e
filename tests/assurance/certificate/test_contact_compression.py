"""The compressed cost of samples in contact against that of their rows, without rounding."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given

import sdpid
from sdpid._common.arrays import Array, Mask
from sdpid.assurance.certificate.compression import enclose_compression, prove_compression
from sdpid.assurance.certificate.contact_record import contact_record
from sdpid.errors import CertificateError
from sdpid.estimation.compression.contact_rows import RANK, ContactRows
from sdpid.estimation.compression.covariance import Weighting
from sdpid.estimation.compression.triangle import Triangle
from sdpid.estimation.compression.whitening import weights
from sdpid.estimation.problem import Problem
from sdpid.experiment.processing.contacts.contact_samples import ContactSamples
from sdpid.verifier.reading import digest
from tests.assurance.certificate.test_compression import (
    SEEDS,
    GivenRows,
    compressed_cost,
    fractions,
    holds,
    mirrored,
    solve,
    times,
)
from tests.helpers.data import random_covariance
from tests.helpers.legged import FEET, NOISE, RADIUS, gait, quadruped


def independent(A: Array, covariance: Array) -> Array:
    """Return as many columns of A (n, m) as count, those furthest from the others' span first.

    Their number is that of singular values above `RANK` of the strongest, columns whitened and
    scaled to unit length; the choice is that of a pivoted factor of the Gram matrix, exactly.
    """
    if not A.size:
        return A
    white = np.linalg.solve(np.linalg.cholesky(covariance), A)
    size = np.linalg.svd(white / np.sqrt(np.sum(white**2, axis=0)), compute_uv=False)
    rank = int(np.count_nonzero(size > RANK * size[0]))
    if rank == A.shape[1]:
        return A
    columns = fractions(A.T)
    weighted = [solve(fractions(covariance), column) for column in columns]
    gram = [times(columns, column) for column in weighted]
    length = [gram[j][j] for j in range(len(gram))]
    kept: list[int] = []
    for _ in range(rank):
        j = max(set(range(len(gram))) - set(kept), key=lambda i: gram[i][i] / length[i])
        kept.append(j)
        gram = [
            [x - row[j] * y / gram[j][j] for x, y in zip(row, gram[j], strict=True)] for row in gram
        ]
    return A[:, sorted(kept)]


@dataclass(frozen=True)
class TouchingRows(GivenRows):
    """Rows of samples in contact, with the efforts (K, n, m) of forces that nobody measured."""

    directions: Array = None  # type: ignore[assignment]
    active: Mask = None  # type: ignore[assignment]

    def contacts(self, part: slice) -> ContactRows | None:
        return ContactRows(self.directions[part], self.active[part], None, None)

    def map(self, function: Any, *arguments: object, sigma: Array) -> list[Any]:
        return [function(self, sigma, *arguments)]

    def cost(self, sigma: Array, weighting: Weighting, base: Array) -> Fraction:
        """Return the least cost over all forces: ``[C A; A^T 0]·(x, f) = (r, 0)`` and r·x.

        Of directions that all but repeat each other as many count as theory's rule says.
        """
        z = [*fractions(base), Fraction(-1)]
        total = Fraction(0)
        for k, (block, used) in enumerate(zip(self.block, self.used, strict=True)):
            own = fractions(block[used])
            r = [sum((a * b for a, b in zip(row, z, strict=True)), Fraction(0)) for row in own]
            covariance = (sigma if sigma.ndim == 2 else sigma[k])[np.ix_(used, used)]
            directions = independent(self.directions[k][used][:, self.active[k]], covariance)
            A, C, m = fractions(directions), fractions(covariance), directions.shape[1]
            if not r or m >= len(r):
                continue
            upper = [[*c, *a] for c, a in zip(C, A, strict=True)]
            lower = [[*[a[j] for a in A], *[Fraction(0)] * m] for j in range(m)]
            x = solve(upper + lower, r + [Fraction(0)] * m)
            total += sum((a * b for a, b in zip(r, x, strict=False)), Fraction(0))
        return total

    def compressed(self, sigma: Array, weighting: Weighting) -> tuple[Array, Array, float]:
        touching = self.contacts(slice(None))
        assert touching is not None
        X = touching.independent(*weights(sigma, self.used), self.block)[0]
        triangle = Triangle(self.block.shape[2])
        triangle.add(X)
        return triangle.split()


# Once whitened, two directions of a sample repeat each other to 5e-9: the rows lose one of them.
@example(seed=273)
@given(seed=SEEDS)
def test_no_point_of_the_box_leaves_the_enclosure(seed: int) -> None:
    """Whatever A, rhs and floor are: those of the rows, or spoiled in any digit."""
    rng = np.random.default_rng(seed)
    n, columns, count = (int(rng.integers(*ends)) for ends in ((2, 5), (2, 5), (1, 7)))
    m = int(rng.integers(0, n + 1))
    block = 10.0 ** rng.uniform(-3, 3, columns) * rng.standard_normal((count, n, columns))
    directions = 10.0 ** rng.uniform(-2, 2, m) * rng.standard_normal((count, n, m))
    if m > 1 and rng.random() < 0.4:
        # A leg that is all but straight.
        directions[..., 1] = directions[..., 0] + 10.0 ** rng.uniform(-6, -2) * directions[..., 1]
    rows = TouchingRows(
        block=block,
        used=rng.random((count, n)) < rng.choice([0.7, 1.0]),
        chunk_size=int(rng.integers(1, count + 1)),
        directions=directions,
        active=rng.random((count, m)) < 0.6,
    )
    scale = 10.0 ** rng.uniform(-2, 2, n)
    each = count if rng.random() < 0.5 else None
    sigma = mirrored(scale[:, None] * random_covariance(rng, n, each) * scale)
    A, rhs, floor = rows.compressed(sigma, "gls")
    spoil = rng.choice([0.0, 1e-14, 1e-8, 1e-2])
    A = A * (1.0 + spoil * rng.standard_normal(A.shape))
    limit = 10.0 ** rng.uniform(-2, 4, len(rhs))
    found = enclose_compression(rows, sigma, "gls", A=A, rhs=rhs, floor=floor, base_limit=limit)
    if not found.proven:
        return
    best = np.clip(np.linalg.lstsq(A, rhs)[0], -limit, limit)
    for base in (np.zeros(len(limit)), limit, rng.uniform(-limit, limit), best):
        of_rows = rows.cost(sigma, "gls", base)
        assert holds(found, of_rows, compressed_cost(A, rhs, floor, base))


def problem_of(samples: sdpid.Samples, **given: Any) -> Problem:
    settings: dict[str, Any] = {"friction": (), "weighting": "residual", "prior": sdpid.Prior()}
    return sdpid.build_problem(quadruped(), samples, **{**settings, **given})


def with_contacts(samples: sdpid.Samples, **given: Any) -> sdpid.Samples:
    assert samples.contacts is not None
    return replace(samples, contacts=replace(samples.contacts, **given))


def samples_of(kind: str) -> sdpid.Samples:
    """Return samples of a quadruped with forces that are known in several ways."""
    made, rng = gait(240), np.random.default_rng(1)
    noisy = replace(made.noisy(), mask=rng.random((240, 18)) < 0.9)
    if kind == "measured":
        return replace(made.measured(0.01 * np.eye(6)), effort=noisy.effort)
    if kind == "kinds":
        return with_contacts(noisy, kind=("point", "line", "plane", "point"))
    if kind == "repeated":
        order = [2, 0, 3, 1, 2]
        assert noisy.contacts is not None
        down = noisy.contacts.down[:, order]
        again = ContactSamples(frames=[FEET[i] for i in order], offset=RADIUS, down=down)
        return replace(noisy, contacts=again)
    return noisy


@pytest.mark.parametrize("kind", ["eliminated", "measured", "kinds", "repeated"])
def test_what_a_quadruped_was_compressed_to_is_near_its_rows(kind: str) -> None:
    problem = problem_of(samples_of(kind))
    found = prove_compression(problem)
    assert found is not None
    assert 0.0 < found.relative < 1e-8
    assert 0.0 < found.absolute < 1e-8 * problem.floor
    certificate = sdpid.certify(sdpid.solve_sdp(problem))
    assert certificate.passed, certificate.summary()


@cache
def certified() -> dict[str, Any]:
    """Return a certificate of a quadruped's samples."""
    return sdpid.certify(sdpid.solve_sdp(problem_of(samples_of("measured")))).to_dict()


def checked(data: dict[str, Any], tmp_path: Path, *, sealed: bool = True) -> Any:
    again = {**data, "sha256": digest(data)} if sealed else data
    path = tmp_path / "certificate.json"
    path.write_text(json.dumps(again), encoding="utf-8")
    return sdpid.verify(path)


def with_record(data: dict[str, Any], **given: Any) -> dict[str, Any]:
    record = {**data["origin"]["contacts"], **given}
    return {**data, "origin": {**data["origin"], "contacts": record}}


def test_a_certificate_names_its_contacts(tmp_path: Path) -> None:
    data, samples = certified(), samples_of("measured")
    found, contacts = data["origin"]["contacts"], samples.contacts
    assert contacts is not None
    assert found["frames"] == list(FEET)
    assert found["kinds"] == ["point"] * 4
    assert found["closed"] == contacts.down.sum(axis=0).tolist()
    assert found["ranks"] == [[0, 240]]
    assert found["base_rows"] == 6
    eliminated = contact_record(problem_of(samples_of("kinds")).rows, np.eye(18))
    assert eliminated is not None
    assert eliminated["force_deviations"] is None
    assert sum(count for _, count in eliminated["ranks"]) == 240
    assert max(rank for rank, _ in eliminated["ranks"]) == 3 + 5 + 6 + 3
    result = checked(data, tmp_path)
    assert result.passed
    said = next(line for line in result.statements if "Contacts" in line)
    assert "point 'FL_FOOT' 55.8 %" in said
    assert "0 in 240 samples" in said
    # What versions before said nothing of.
    origin = {key: value for key, value in data["origin"].items() if key != "contacts"}
    assert checked({**data, "version": 4, "origin": origin}, tmp_path).passed


@pytest.mark.parametrize(
    "given",
    [
        {"frames": ["FL_FOOT"]},
        {"kinds": ["ball"] * 4},
        {"closed": [241, 0, 0, 0]},
        {"ranks": [[0, 239]]},
        {"ranks": [[0, 120], [0, 120]]},
        {"widened_s": "long"},
        {"force_deviations": [[0.1] * 6]},
        {"effort_deviations": [1.0] * 17},
        {"more": 1},
    ],
)
def test_a_changed_record_of_contacts_is_refused(given: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(CertificateError):
        checked(with_record(certified(), **given), tmp_path)


def test_a_record_of_contacts_is_under_the_digest(tmp_path: Path) -> None:
    forged = with_record(certified(), widened_s=0.25)
    result = checked(forged, tmp_path, sealed=False)
    assert not result.passed
    assert "digest" in result.problems[0]
    nothing = {**certified()["origin"], "contacts": None}
    assert not checked({**certified(), "origin": nothing}, tmp_path, sealed=False).passed


@pytest.mark.parametrize("change", ["flags", "offset", "sigma"])
def test_rows_with_other_contacts_have_another_compression(change: str) -> None:
    """A compression of the same log with feet, flags or weights that are not those of the rows."""
    samples = samples_of("eliminated")
    given = replace(samples, covariance=np.diag(NOISE**2))
    assert samples.contacts is not None
    changed = {
        "flags": with_contacts(given, down=~samples.contacts.down),
        "offset": with_contacts(given, offset=(0.0, 0.0, -0.0181)),
        "sigma": replace(given, covariance=np.diag(NOISE**2 * 1.001)),
    }[change]
    problem = problem_of(given, weighting="gls", prior=None, check_excitation=False)
    other = problem_of(changed, weighting="gls", prior=None, check_excitation=False)
    forged = prove_compression(replace(problem, rows=other.rows, sigma=other.sigma))
    assert forged is None or forged.relative > 1e-6

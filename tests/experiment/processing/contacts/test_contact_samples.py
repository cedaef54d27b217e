"""Contacts of samples: checked, cut and joined with them."""

from typing import Any

import numpy as np
import pytest

from sdpid import Samples
from sdpid.errors import DataError
from sdpid.experiment.processing.contacts.contact_samples import ContactSamples
from tests.helpers.refusals import refuses

FEET = ("left", "right")


def contacts(K: int = 12, **given: Any) -> ContactSamples:
    rng = np.random.default_rng(K)
    down = rng.random((K, 2)) < 0.5
    return ContactSamples(**{"frames": FEET, "down": down, **given})


def samples(K: int = 12, **given: Any) -> Samples:
    rng = np.random.default_rng(K + 1)
    states = {name: rng.normal(size=(K, 8)) for name in ("velocity", "acceleration", "effort")}
    return Samples(position=rng.normal(size=(K, 9)), contacts=contacts(K, **given), **states)


def test_parts_and_joins_keep_contacts() -> None:
    covariance = np.diag([1.0, 1.0, np.inf, 5.0, 5.0, 5.0])
    forces = np.random.default_rng(3).normal(size=(12, 2, 6))
    whole = samples(forces=forces, force_covariance=covariance)
    # Points transmit no moments, whatever is given.
    assert not whole.contacts.forces[:, :, 3:].any()
    assert not whole.contacts.force_covariance[:, 3:].any()  # type: ignore[index]
    parts = [whole.between(0, 5), whole.between(5, 12)]
    joined = Samples.join(parts)
    assert joined.contacts.forces is not None
    np.testing.assert_array_equal(joined.contacts.down, whole.contacts.down)
    np.testing.assert_array_equal(joined.contacts.forces, whole.contacts.forces)
    for piece, part in zip(joined.pieces, parts, strict=True):
        np.testing.assert_array_equal(piece.contacts.down, part.contacts.down)
    thin = whole.every(4).contacts
    np.testing.assert_array_equal(thin.down, whole.contacts.down[::4])
    assert "2 contacts" in repr(whole)
    assert "forces measured" in repr(thin)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"down": np.zeros((12, 3), dtype=bool)}, r"down has shape \(12, 3\)"),
        ({"down": np.zeros((12, 2))}, "type float64"),
        ({"kind": "ball"}, "kind is 'ball'"),
        ({"offset": np.zeros(2)}, r"offset has shape \(2,\)"),
        ({"forces": np.zeros((12, 2, 6))}, "forces and force_covariance together"),
        (
            {"forces": np.zeros((11, 2, 6)), "force_covariance": np.eye(6)},
            r"forces have shape \(11, 2, 6\)",
        ),
        (
            {"forces": np.zeros((12, 2, 6)), "force_covariance": -np.eye(6)},
            "least eigenvalue is -1",
        ),
    ],
)
def test_refuses(given: dict[str, Any], said: str) -> None:
    refuses(DataError, said, contacts, **given)


def test_refuses_other_contacts_in_one_join() -> None:
    with pytest.raises(DataError, match="contacts: those of piece 2"):
        Samples.join([samples(), samples(offset=(0.0, 0.0, -0.02))])
    with pytest.raises(DataError, match="contacts: are of 12 samples, expected 5"):
        Samples(
            position=np.zeros((5, 9)),
            velocity=np.zeros((5, 8)),
            acceleration=np.zeros((5, 8)),
            effort=np.zeros((5, 8)),
            contacts=contacts(),
        )

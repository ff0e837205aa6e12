"""Tangents of contact at finite deformation against differences."""

import numpy as np
from scipy.sparse import bmat


def tangent_errors(contact, z, q, on, held, rng):
    """(4, 2) by how much differences of forces and own equations along random directions differ
    from their derivative, and how large they are."""
    free, h, both = np.ones(len(z), dtype=bool), 1e-6, np.concatenate([z, q])

    def values(both):
        z, q = np.split(both, [len(free)])
        t = contact.terms(contact.place(z, q, held), q, on, held, free)
        return np.concatenate([-t.force, t.rest]), t

    t = values(both)[1]
    whole = bmat([[t.K, t.top], [t.left, t.own]]).toarray()
    ways = rng.standard_normal((4, len(both)))
    found = [(values(both + h * e)[0] - values(both - h * e)[0]) / (2 * h) for e in ways]
    off = [whole @ e - difference for e, difference in zip(ways, found, strict=True)]
    return np.abs([off, found]).max(axis=2).T

"""Eigenvalues along a path keep their order, also where some of them are at minus infinity."""

from __future__ import annotations

import numpy as np

from vsgdesign.linear.stability.loci import track


def test_a_mode_that_ends_within_a_sample_has_no_say() -> None:
    """z = 0 is s = −∞ on the whole path: the difference of both was a warning on the terminal."""
    never = complex(-np.inf, 0.0)
    path = np.array([[-1 + 1j, -5, never], [never, -1.1 + 1j, -5.2], [-5.4, never, -1.2 + 1j]])
    found = track(path)
    np.testing.assert_array_equal(found[:, 0], [-1 + 1j, -1.1 + 1j, -1.2 + 1j])
    np.testing.assert_array_equal(found[:, 1], [-5, -5.2, -5.4])
    assert not np.isfinite(found[:, 2]).any()

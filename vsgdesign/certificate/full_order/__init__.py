"""A proof of the sampled full-order model: all its eigenvalues lie inside a circle, for every grid, power and estimate
of a region (docs/theory/full-order-proof.md)."""

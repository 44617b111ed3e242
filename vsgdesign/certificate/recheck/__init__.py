"""A second look at a full-order proof, which shares nothing with what made it: it reads the file itself, derives the
loop in plain numbers, and encloses it with polynomials of its own (docs/theory/full-order-proof.md)."""

"""The sampled full-order loop while its gains change on a grid that rests: one function that falls under all gains that
an estimate within its error leads to."""

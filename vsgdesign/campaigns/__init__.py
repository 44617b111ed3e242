"""Many EMT runs with one verdict: random cases of a promise, and the tests of a grid code."""

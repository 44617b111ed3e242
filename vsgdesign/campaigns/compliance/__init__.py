"""Tests of grid-forming converters as data: suites, their runs, what is measured, and the verdicts."""

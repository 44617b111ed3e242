"""Timings of the hot paths: ``python -m bench``. Never part of the tests."""

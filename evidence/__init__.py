"""Measurements too long for the test suite, whose figures stand in the documents: ``python -m evidence``."""

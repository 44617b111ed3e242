"""Figures and page of a stability assessment."""

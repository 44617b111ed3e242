"""Figures and page of an EMT scenario."""

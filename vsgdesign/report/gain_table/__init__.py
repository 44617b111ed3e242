"""Figures and page of a gain table."""

"""Figures and pages of the estimators."""

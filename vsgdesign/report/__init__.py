"""Figures and pages of each kind of result, on paper, terminal and screen."""

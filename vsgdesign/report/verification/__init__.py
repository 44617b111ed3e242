"""Figures and page of a verification: what a reader sees of ``vsgdesign verify``."""

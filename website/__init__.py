"""Builds the web site of the documents. Not part of the package."""

"""Many disturbances of a converter: side by side, on many cores, and kept as they finish."""

"""Random cases in EMT: drawn, run in blocks, counted, and said with exact bounds."""

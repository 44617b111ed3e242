"""vsgdesign: grid-forming converter design, from a datasheet to a gain schedule proven in EMT."""

__version__ = "0.2.0"

"""Small signals: the models, the operating points around which they hold, and what follows for stability."""

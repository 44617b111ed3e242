"""The learned part of the field estimator: its recipe, runs, training, and what it adds to the recursions alone."""

"""The explorer: a page in the browser on which one drags the grid and watches the converter.

Nothing heavy is imported here: the page is served before the models are loaded.
"""

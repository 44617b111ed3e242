"""The functions of ``import vsgdesign as vd``. They take a study and return results with figures.

They do no work of their own but call the other rooms.
"""

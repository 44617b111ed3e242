"""The physics and the control laws, each written once as a plain function of scalars.

The same function is called with floats, traced by CasADi and compiled as a part of a loop. Each function therefore uses
NumPy ufuncs only, has no branch on a traced value, takes and returns scalars, tuples or NamedTuples, and imports the
functions of this project by name.
"""

"""The physics and the control laws, each written once as a plain function of scalars.

The same function is called with floats, traced by CasADi and compiled by Numba. So: NumPy ufuncs only, no
branch on a traced value, tuples or NamedTuples in and out, and functions of this project imported by name.
"""

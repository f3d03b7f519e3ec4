"""Functions from arrays to new arrays: connectivity, geometry, operators and kernels.

Kernels are machine code, loaded from one library at their first call (see ``library``).
"""

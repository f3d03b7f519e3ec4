"""Arrays in, new arrays out: connectivity, geometry, operators and the kernels below them.

Kernels are machine code, loaded from one library at their first call (see ``library``).
"""

"""Arrays in, new arrays out: connectivity, geometry, operators and the kernels below them.

Kernels are compiled, or their machine code loaded, at their first call (see ``compiled``).
"""

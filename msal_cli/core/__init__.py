"""Arrays in, new arrays out: connectivity, geometry, operators and the kernels below them.

Modules that hold numba kernels import numba when they are imported; everything above imports
them only inside the function that needs them.
"""

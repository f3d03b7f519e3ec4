"""Compiles the kernels of msal into one shared library; part of a checkout, not of a wheel.

python -m kernel_build
"""

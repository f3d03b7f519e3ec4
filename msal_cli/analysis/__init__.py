"""Measures of one mesh, and of a mesh against another with the same faces."""

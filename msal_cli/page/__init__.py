"""Meshes as a page: one HTML file that draws them and asks the network for nothing."""

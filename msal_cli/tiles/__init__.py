"""Meshes larger than memory, and sets of meshes that touch: denoised tile by tile."""

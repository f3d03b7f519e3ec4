"""Pictures of meshes as PNG and pages, without a graphics card and without a display."""

"""Pictures of meshes as PNG, without a graphics card and without a display; and pages."""

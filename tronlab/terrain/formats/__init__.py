"""File formats of height maps and meshes, one module each."""

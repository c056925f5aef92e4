"""Point clouds and triangle meshes."""

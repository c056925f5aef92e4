"""Point clouds as PLY, triangle meshes as STL."""

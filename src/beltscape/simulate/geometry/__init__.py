"""The simulated world: solids, cameras and projector, triangle meshes, exact ray casting."""

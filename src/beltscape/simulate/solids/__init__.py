"""The solids on the belt as triangle meshes: belt, board, module, heaps of rocks and fines."""

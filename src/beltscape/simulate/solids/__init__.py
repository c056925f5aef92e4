"""The solids on the belt as triangle meshes: belt, board, module, heaps of rocks and fines.

`belt` is the empty one; `heap` lets `rocks` fall on `fines`; `board` has the targets.
"""

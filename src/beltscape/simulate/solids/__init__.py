"""The solids on the belt as triangle meshes: belt, board, module, heaps of rocks and fines.

`belt` is the empty one; `heap` lets `rocks` of the `rock_sizes` fall by `deposition` on `fines`, with the reflectance
of `material`; `board` and `module` are the targets.
"""

"""Detection of the board's corners in images, to a hundredth of a pixel, with a check of the described board.

`detect_capture` detects the board in every image in parallel, `detector` in one, to about a pixel; `subpixel`
refines the corners by the model of a saddle. `corners` is the result, without what a given lens has no ray
for; `board_mismatch` describes the board that the images show if it is another one.
"""

"""Detection of the board's corners: in images, to a hundredth of a pixel, with a check of the described board.

`detect_capture` detects the board in every image in parallel, `detector` in one: `markers` or `chessboard` find the
corners to about a pixel, `subpixel` refines them by the model of `saddle`. `corners` is the result, `domain` leaves
out what a given lens has no ray for, `board_mismatch` describes the board that the images show if it is another one.
"""

"""Reading and writing: every format the product speaks, one file each."""

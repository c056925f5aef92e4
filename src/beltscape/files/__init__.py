"""Reading and writing of all file formats, one module per format; `exchange` has the formats of other programs."""

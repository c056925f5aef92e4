"""One module per command, of its name, in the folder of its group: parse, call one function, print."""

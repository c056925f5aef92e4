"""One module per command, of its name: parse, call one function, print."""

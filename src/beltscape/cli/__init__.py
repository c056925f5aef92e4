"""The program ``beltscape``: thin files that parse, call one function, print.

`main` selects one of the `commands`, runs it, and gives errors their exit codes. `catalogue` lists the
commands in their groups, with examples. `arguments` and `output` are shared by commands; `terminal` shows
progress and warnings.
"""

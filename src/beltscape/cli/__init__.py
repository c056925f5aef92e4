"""The program ``beltscape``: `main` selects one of `commands`, thin files that parse, call one function, print.

`catalogue` lists the commands in their groups; `quantities` and `evaluations` are those of ``beltscape measure`` and
``beltscape evaluate``. `arguments`, `output` and `fit` are shared by commands; `terminal` shows progress, `failure`
gives errors their exit codes.
"""

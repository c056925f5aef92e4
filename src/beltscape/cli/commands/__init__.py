"""One module per command, of its name: parse, call one function, print.

``beltscape measure`` and ``beltscape evaluate`` have a module for each quantity and each evaluation, such as
``measure_belt``.
"""

"""One module per quantity of ``beltscape measure``, of its name."""

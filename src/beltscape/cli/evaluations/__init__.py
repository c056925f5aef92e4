"""One module per evaluation of ``beltscape evaluate``, of its name."""

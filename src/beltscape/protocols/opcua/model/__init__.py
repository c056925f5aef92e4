"""The address space: namespaces, companion types, quantities, and the objects of one belt."""

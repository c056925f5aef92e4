"""Where finished records and raw frames go: historian, tables, recordings."""

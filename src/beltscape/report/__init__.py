"""Results as pictures and as self-contained HTML pages."""

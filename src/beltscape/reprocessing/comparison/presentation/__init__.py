"""Presentation of a comparison: sentences for terminal and page, JSON document, page with charts."""

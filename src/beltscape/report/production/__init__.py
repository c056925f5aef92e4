"""Reports of shifts and days: `document` holds the figures, `texts` the words, `page` makes HTML, `pdf` prints it.

``python -m beltscape.report.production FILE.json`` renders a document, in a process of its own.
"""

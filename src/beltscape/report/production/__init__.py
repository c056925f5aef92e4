"""Reports of shifts and days as pages and PDF.

`document` holds the figures, `texts` the words in the languages of the folder ``languages``, `page` makes
HTML, `pdf` prints it. ``python -m beltscape.report.production FILE.json`` renders a document, in a process of
its own.
"""

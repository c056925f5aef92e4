"""Building blocks of reports: charts, pictures, colours and 3-D scenes."""

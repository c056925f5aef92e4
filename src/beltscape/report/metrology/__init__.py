"""Pages of certificates, of a total's explanation, and of a year's uncertainty, in the languages of `languages`."""

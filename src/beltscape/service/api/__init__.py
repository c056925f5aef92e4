"""What programs may ask for by HTTP; one file per subject."""

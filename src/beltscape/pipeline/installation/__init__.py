"""The checks of ``beltscape doctor``: what is installed, and whether the machine suits the job."""

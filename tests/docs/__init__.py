"""Tests of the manual: every command and code block that it shows is run."""

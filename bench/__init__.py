"""Measurements: programs that print tables. Not tests: they assert nothing and depend on the machine."""

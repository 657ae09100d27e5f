"""The cell: look, find, plan, fetch, report; and everything that keeps it running."""

DISTRIBUTION = "mikado-cell"

"""Finding thin parts in a stereo pair: arrays and frozen records in, frozen records out."""

DISTRIBUTION = "mikado-cell"

"""One device each, behind the Protocols of `drivers.interfaces`."""

DISTRIBUTION = "mikado-cell"

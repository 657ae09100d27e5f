"""PLCs: the register map, and Modbus TCP."""

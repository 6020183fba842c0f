"""A gel's modulus and friction, from sweeps over it."""

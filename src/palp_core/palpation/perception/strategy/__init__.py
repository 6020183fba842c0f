"""Which stiffness comes next."""
